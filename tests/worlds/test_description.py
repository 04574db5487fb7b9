"""Worlds as YAML files and drawings, readers of users, and mistakes in files."""

import math

import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.worlds import ImportOptions, World
from tb2rl.worlds.description import parse_world
from tb2rl.worlds.registry import read_world

EMPTY = {"start": [0, 0, 0], "bounds": [-5, -5, 5, 5]}
DRAWING = "\n#####\n#S.G#\n#.  #\n#####\n"


def test_walls_boxes_posts_and_all_other_keys_are_read():
    path = [[-2, -2], [2, -2], [2, 2], [-2, 2]]
    shapes = {
        "walls": [{"path": path, "closed": True, "thickness": 0.4}],
        "boxes": [{"centre": [3.5, 0], "size": [2, 0.4], "yaw": math.radians(30)}],
        "posts": [{"centre": [-4, 1], "radius": 0.5}],
    }
    world = parse_world({**EMPTY, **shapes, "goal": [4, 4, 1.5], "description": "a room"}, "mine")
    room = shapely.box(-2.2, -2.2, 2.2, 2.2).difference(shapely.box(-1.8, -1.8, 1.8, 1.8))
    box = shapely.affinity.rotate(shapely.box(2.5, -0.2, 4.5, 0.2), 30)
    expected = shapely.union_all([room, box, shapely.Point(-4, 1).buffer(0.5, quad_segs=32)])
    assert world.obstacles.symmetric_difference(expected).area == pytest.approx(0, abs=1e-9)
    assert (world.name, world.description) == ("mine", "a room")
    assert (world.start, world.goal, world.bounds) == ((0, 0, 0), (4, 4, 1.5), (-5, -5, 5, 5))
    opened = parse_world({**EMPTY, "walls": [{"path": path, "thickness": 0.4}]}, "open")
    assert opened.clearance(-2, 0) == pytest.approx(1.8)


def test_a_drawing_has_its_origin_at_the_lower_left_and_other_keys_take_precedence_over_it():
    world = parse_world({"drawing": DRAWING, "cell": 0.5}, "drawing")
    assert (world.start, world.goal) == ((0.75, 1.25, 0), (1.75, 1.25, 0))
    assert world.bounds == (0, 0, 2.5, 2)
    assert world.free_space(0.0).bounds == pytest.approx((0.5, 0.5, 2, 1.5))
    assert len(world.boxes) == 4, "a row each below and above, a column each side"
    posts = [{"centre": [9, 9], "radius": 1}]
    world = parse_world({"drawing": DRAWING, "cell": 1.0, "start": [2.5, 1.5, 3.0], "posts": posts}, "mine")
    assert (world.start, world.goal) == ((2.5, 1.5, 3.0), (3.5, 2.5, 0.0))
    assert world.bounds == pytest.approx((0, 0, 10, 10))


def test_every_hash_of_a_drawing_is_a_wall_and_nothing_else_is():
    lines = ["S.##..#", "#.##", "..###.#", "########", "#...#"]
    world = parse_world({"drawing": "\n".join(lines), "cell": 0.5, "bounds": [0, 0, 9, 9]}, "steps")
    for row, line in enumerate(reversed(lines)):
        for column, mark in enumerate(line):
            assert (world.clearance(0.5 * column + 0.25, 0.5 * row + 0.25) == 0) == (mark == "#")
    assert world.obstacles.area == pytest.approx("".join(lines).count("#") / 4)


def read(path):
    return World.from_shapes(path.stem, [(9, 9, 1, 2, 0.3)], posts=[(6, 6, 0.5)], start=(0, 0, 7))


@pytest.mark.parametrize(
    ("file", "text", "reader"),
    [
        ("mine.txt", DRAWING, None),
        ("mine.yml", "{start: [1.5, 2.5, 0.0], bounds: [0, 0, 4, 4]}", None),
        ("mine.txt", "not a drawing", read),
    ],
)
def test_a_file_is_read_by_its_ending_or_a_users_reader(file, text, reader, tmp_path):
    (tmp_path / file).write_text(text)
    start, goal, bounds = (3, 3, 1), (3.5, 3, 0), (0, 0, 20, 20)
    world = read_world(tmp_path / file, reader)
    changed = read_world(tmp_path / file, reader, ImportOptions(start, goal, bounds))
    assert (changed.name, changed.start, changed.goal, changed.bounds) == ("mine", start, goal, bounds)
    assert changed.boxes.tolist() == world.boxes.tolist()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"drawing": "#..#"}, ["no start", "start:", "an S"]),
        ({"drawing": "##\n#x"}, ["the drawing has 'x' in line 2, column 2; it takes # (wall), one S (start), one G"]),
        ({"drawing": "#####\n#S..#\n#..S#\n#####"}, ["has 'S' in line 3, column 4; it takes # (wall), one S (start)"]),
        ({"start": [0, 0, 0]}, ["without obstacles", "bounds"]),
        ({**EMPTY, "boxs": []}, ["unknown key", "'boxs'", "did you mean 'boxes'", "walls"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3], "size": [1, -1]}]}, ["boxes.0.size.1", "greater than 0", "-1"]),
        ("walls", ["mapping", "'walls'"]),
    ],
)
def test_a_mistake_in_a_description_is_one_line(content, words):
    with pytest.raises(InputError, match="world mine") as error:
        parse_world(content, "mine")
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)
