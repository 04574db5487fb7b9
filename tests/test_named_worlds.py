"""Worlds by name, by file, by a user's reader, and made by code."""

import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.envs.worlds import absolute_worlds
from tb2rl.worlds.registry import find_world, world_names

DRAWING = "#####\n#S.G#\n#...#\n#####\n"
MODULE = """
from tb2rl.worlds import World

def read(path) -> World:
    radius = float(path.read_text())
    return World.from_shapes(path.stem, posts=[(5, 0, radius)], start=(0, 0, 0), bounds=(-2, -2, 8, 2))

POST = World.from_shapes("post", posts=[(5, 0, 1)], start=(0, 0, 0), bounds=(-2, -2, 8, 2))

def make() -> World:
    return POST

def read_nothing(path) -> World:
    return path.read_text()

def remove(path):
    path.unlink()

NUMBER = 7
"""


@pytest.fixture
def my_worlds(module_folder):
    """A user's module, in the working directory."""
    (module_folder / "my_worlds.py").write_text(MODULE)
    (module_folder / "post.radius").write_text("0.5")
    (module_folder / "mine.txt").write_text(DRAWING, encoding="utf-8-sig")  # the mark is no part of the world
    return module_folder


def test_every_built_in_world_is_found_by_its_name_and_read_once():
    assert [find_world(name).name for name in world_names()] == world_names()
    assert find_world("loop") is find_world("loop")


def test_worlds_are_read_by_a_users_reader_and_made_by_code(my_worlds):
    world = find_world("my_worlds:read:post.radius")
    assert (world.name, world.posts.tolist()) == ("post", [[5.0, 0.0, 0.5]])
    assert find_world("my_worlds:POST").posts.tolist() == [[5.0, 0.0, 1.0]]
    assert find_world("my_worlds:make") is find_world("my_worlds:POST")
    env = make_env("maze", "raw", world="my_worlds:POST", start="fixed", beams=1)
    assert env.reset()[0] == pytest.approx([4.0])
    env.close()


def test_a_format_of_another_package_is_read_by_the_ending_of_its_files(write_package, tmp_path):
    write_package("[tb2rl.worlds]\nradius = my_other_worlds:read\n", my_other_worlds=MODULE)
    (tmp_path / "mine.radius").write_text("1.5")
    assert find_world(str(tmp_path / "mine.radius")).posts.tolist() == [[5.0, 0.0, 1.5]]


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("lop", "unknown world 'lop'; did you mean 'loop'.* known: circuit, loop, maze, round, wall"),
        ("post.radius", r"unknown extension of the world file .*: '\.radius'.*\.txt, \.world, \.yaml"),
        ("my_worlds:NUMBER", r"world 'my_worlds:NUMBER': .* def NUMBER\(\.\.\.\) -> World"),
        ("os:remove:post.radius", "a function that makes worlds"),
        ("my_worlds:read_nothing:post.radius", "is not a tb2rl.worlds.World but str"),
        ("my_worlds:read", r"'my_worlds:read' cannot be called as read\(\): missing .* 'path'"),
        ("my_worlds:read:missing.radius", "there is no world file .*missing.radius"),
    ],
)
def test_a_reference_that_is_no_world_is_refused_in_one_line_and_runs_no_other_code(reference, words, my_worlds):
    with pytest.raises(InputError, match=words) as error:
        find_world(reference)
    assert "\n" not in str(error.value)
    assert (my_worlds / "post.radius").is_file()  # nothing else is called


def test_a_reference_to_a_file_becomes_absolute_and_any_other_stays(my_worlds, monkeypatch):
    (my_worlds / "loop").mkdir()  # does not replace the built-in world
    assert [absolute_worlds(name) for name in ("loop", "my_worlds:POST")] == ["loop", "my_worlds:POST"]
    found = [absolute_worlds(reference) for reference in ("mine.txt", "my_worlds:read:post.radius")]
    monkeypatch.chdir("/")
    assert [find_world(reference).name for reference in found] == ["mine", "post"]
