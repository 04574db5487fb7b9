"""Files of worlds: their readers, and files that cannot be read."""

import os

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.worlds import ImportOptions, World
from tb2rl.worlds.readers import read_world

DRAWING = "#####\n#S.G#\n#...#\n#####\n"
YAML = "start: [1.5, 2.5, 0.0]\nwalls: [{path: [[0, 0], [4, 0], [4, 4], [0, 4]], closed: true}]\n"


def read(path):
    return World.from_shapes(path.stem, [(9, 9, 1, 2, 0.3)], posts=[(6, 6, 0.5)], start=(0, 0, 7))


@pytest.mark.parametrize(
    ("file", "text", "reader", "start"),
    [
        ("mine.txt", DRAWING, None, (3.0, 5.0, 0.0)),
        ("mine.yml", YAML, None, (1.5, 2.5, 0.0)),
        ("mine.txt", "not a drawing", read, (0, 0, 7)),
    ],
)
def test_a_file_is_read_by_its_ending_or_a_users_reader(file, text, reader, start, tmp_path):
    (tmp_path / file).write_text(text)
    world = read_world(tmp_path / file, reader)
    assert (world.name, world.start) == ("mine", start)
    options = ImportOptions(start=(3, 3, 1), goal=(3.5, 3, 0), bounds=(0, 0, 20, 20))
    changed = read_world(tmp_path / file, reader, options)
    assert (changed.start, changed.goal, changed.bounds) == ((3, 3, 1), (3.5, 3, 0), (0, 0, 20, 20))
    assert np.allclose(changed.boxes, world.boxes)


def test_a_file_is_read_once_and_again_when_it_changed(tmp_path):
    file = tmp_path / "mine.txt"
    file.write_text("#S..#")
    before = read_world(file)
    assert read_world(file) is before
    file.write_text("#.S.#")
    os.utime(file, ns=(0, 1))  # two writes within a tick of the file system's clock look alike
    assert read_world(file).start != before.start


@pytest.mark.parametrize(("name", "content"), [("bad.yaml", b"walls: [\n  a: b: c\n"), ("bad.txt", b"S..\xff#")])
def test_a_file_that_cannot_be_read_is_named_in_one_line(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name) as error:
        read_world(tmp_path / name)
    assert "\n" not in str(error.value)
