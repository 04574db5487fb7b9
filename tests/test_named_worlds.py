"""Worlds by name, by file, by a user's reader, and made by code."""

from __future__ import annotations

from pathlib import Path

import pytest

from tb2rl import load, make_env
from tb2rl.core.errors import InputError
from tb2rl.envs.worlds import absolute_worlds
from tb2rl.runs.loading import config_of
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
def my_worlds(workdir, monkeypatch):
    """A user's module, in the working directory."""
    (workdir / "my_worlds.py").write_text(MODULE)
    (workdir / "post.radius").write_text("0.5")
    (workdir / "mine.txt").write_text(DRAWING)
    monkeypatch.syspath_prepend(workdir)
    return workdir


def test_every_built_in_world_is_found_by_its_name_and_read_once():
    for name in world_names():
        assert find_world(name).name == name
        assert find_world(name) is find_world(name)


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


@pytest.mark.parametrize("make", [Path.touch, Path.mkdir], ids=["file", "folder"])
def test_a_file_or_folder_of_the_same_name_does_not_replace_a_built_in_world(make, workdir):
    make(Path("loop"))
    assert absolute_worlds("loop") == "loop"
    assert config_of(load("zoo:maze-loop-qlearn")).task.world == "loop"


@pytest.mark.parametrize("name", ["mine.txt", "mine.yaml"])
def test_a_byte_order_mark_is_no_part_of_a_world(name, tmp_path):
    text = {"mine.txt": DRAWING, "mine.yaml": f"drawing: {DRAWING!a}"}[name].replace("'", '"')
    (tmp_path / name).write_text(text, encoding="utf-8-sig")
    assert find_world(str(tmp_path / name)).start == (3.0, 5.0, 0)


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("lop", "unknown world 'lop'; did you mean 'loop'.* known: circuit, loop, maze, round, wall"),
        ("missing.yaml", "no world file missing.yaml"),
        ("nowhere/loop", "no world file nowhere/loop"),
        ("post.radius", r"unknown ending of the world file .*: '\.radius'.*\.txt, \.world, \.yaml"),
        ("my_worlds:NUMBER", r"world 'my_worlds:NUMBER': .* def NUMBER\(\.\.\.\) -> World"),
        ("my_worlds:remove:post.radius", r"a function that makes worlds .*: def remove\(\.\.\.\) -> World"),
        ("os:remove:post.radius", "a function that makes worlds"),
        ("my_worlds:read_nothing:post.radius", "is not a tb2rl.worlds.World but str"),
        ("my_worlds:read", "world 'my_worlds:read' reads files; write my_worlds:read:PATH"),
        ("my_worlds:make:post.radius", "my_worlds:make reads no file; write my_worlds:make"),
        ("my_worlds:read:missing.radius", "there is no world file .*missing.radius"),
        ("my_worlds:NOWHERE", "module 'my_worlds' has no 'NOWHERE'"),
        ("my_other_module:POST", "there is no module 'my_other_module'"),
    ],
)
def test_a_reference_that_is_no_world_is_refused_in_one_line_and_runs_no_other_code(reference, words, my_worlds):
    with pytest.raises(InputError, match=words) as error:
        find_world(reference)
    assert "\n" not in str(error.value)
    assert (my_worlds / "post.radius").is_file()  # nothing else is called


@pytest.mark.parametrize("reference", ["my_worlds:make", "my_worlds:read"])
def test_a_generator_with_other_arguments_is_refused_with_one_line(reference, my_worlds):
    name = reference.partition(":")[2]
    with pytest.raises(InputError, match=rf"cannot be called as {name}\(rng, difficulty, size\): too many positional"):
        make_env("maze", world={"generator": reference})


def test_a_reference_to_a_file_becomes_absolute_and_any_other_stays(my_worlds, monkeypatch):
    assert absolute_worlds("mine.txt") == str(my_worlds / "mine.txt")
    assert absolute_worlds("my_worlds:read:post.radius") == f"my_worlds:read:{my_worlds / 'post.radius'}"
    assert absolute_worlds("my_worlds:POST") == "my_worlds:POST"
    found = [absolute_worlds(reference) for reference in ("mine.txt", "my_worlds:read:post.radius")]
    monkeypatch.chdir("/")
    assert [find_world(reference).name for reference in found] == ["mine", "post"]
