"""Files of worlds: which reader opens them, and what cannot be read."""

import os

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.worlds import ImportOptions, World
from tb2rl.worlds.readers import READERS, read_world

DRAWING = "#####\n#S.G#\n#...#\n#####\n"
YAML = "start: [1.5, 2.5, 0.0]\nwalls: [{path: [[0, 0], [4, 0], [4, 4], [0, 4]], closed: true}]\n"


@pytest.mark.parametrize(("file", "text", "start"), [
    ("mine.txt", DRAWING, (3.0, 5.0, 0.0)),
    ("mine.yaml", YAML, (1.5, 2.5, 0.0)),
    ("mine.yml", YAML, (1.5, 2.5, 0.0)),
])  # fmt: skip
def test_the_ending_of_a_files_name_says_what_reads_it(file, text, start, tmp_path):
    (tmp_path / file).write_text(text)
    world = read_world(tmp_path / file)
    assert (world.name, world.start) == ("mine", start)
    assert (tmp_path / file).suffix in READERS


def test_a_reader_of_ones_own_is_used_instead(tmp_path):
    (tmp_path / "mine.txt").write_text("7")

    def read(path):
        return World.from_shapes(path.stem, posts=[(3, 0, 1)], start=(0, 0, float(path.read_text())))

    assert read_world(tmp_path / "mine.txt", read).start == (0, 0, 7)


@pytest.mark.parametrize(("file", "text"), [("mine.txt", DRAWING), ("mine.yaml", YAML), ("my.own", "")])
def test_a_start_and_a_goal_can_be_given_beside_any_file(file, text, tmp_path):
    (tmp_path / file).write_text(text)

    def read(path):
        return World.from_shapes(path.stem, [(9, 9, 1, 2, 0.3)], posts=[(6, 6, 0.5)], start=(0, 0, 0))

    reader = read if file == "my.own" else None
    before = read_world(tmp_path / file, reader)
    after = read_world(tmp_path / file, reader, ImportOptions(start=(3, 3, 1), goal=(3.5, 3, 0), bounds=(0, 0, 20, 20)))
    assert (after.start, after.goal, after.bounds) == ((3, 3, 1), (3.5, 3, 0), (0, 0, 20, 20))
    assert np.allclose(after.boxes, before.boxes)
    assert np.allclose(after.posts, before.posts)
    assert read_world(tmp_path / file, reader).start == before.start


def test_a_start_beside_the_file_is_enough(tmp_path):
    (tmp_path / "mine.yaml").write_text(YAML.replace("start: [1.5, 2.5, 0.0]\n", ""))
    assert read_world(tmp_path / "mine.yaml", options=ImportOptions(start=(1, 1, 0))).start == (1, 1, 0)


def test_a_file_is_read_once_and_again_when_it_changed(tmp_path):
    file = tmp_path / "mine.txt"
    file.write_text("#S..#")
    before = read_world(file)
    assert read_world(file) is before
    file.write_text("#.S.#")
    os.utime(file, ns=(0, 1))  # two writes within a tick of the file system's clock look alike
    assert read_world(file).start != before.start


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("bad.yaml", b"walls: [\n  a: b: c\n"),
        ("bad.yaml", b": 3"),
        ("bad.yaml", b"\xff\xfe"),
        ("bad.txt", b"S..\xff#"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_with_one_line_that_names_it(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name) as error:
        read_world(tmp_path / name)
    assert "\n" not in str(error.value)


def test_a_drawing_of_too_many_squares_is_refused(tmp_path):
    (tmp_path / "huge.txt").write_text("S." + "#." * 200_000)
    with pytest.raises(InputError, match="world huge: the drawing has more than 262144 squares, the limit"):
        read_world(tmp_path / "huge.txt")
