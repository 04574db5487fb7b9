"""Worlds as YAML files and drawings, and mistakes in them."""

import math
import re

import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tb2rl.core.errors import InputError
from tb2rl.worlds.description import world_from

EMPTY = {"start": [0, 0, 0], "bounds": [-5, -5, 5, 5]}
DRAWING = "\n#####\n#S.G#\n#.  #\n#####\n"


def test_walls_boxes_posts_and_all_other_keys_are_read():
    path = [[-2, -2], [2, -2], [2, 2], [-2, 2]]
    shapes = {
        "walls": [{"path": path, "closed": True, "thickness": 0.4}],
        "boxes": [{"centre": [3.5, 0], "size": [2, 0.4], "yaw": math.radians(30)}],
        "posts": [{"centre": [-4, 1], "radius": 0.5}],
    }
    world = world_from({**EMPTY, **shapes, "goal": [4, 4, 1.5], "description": "a room"}, "mine")
    room = shapely.box(-2.2, -2.2, 2.2, 2.2).difference(shapely.box(-1.8, -1.8, 1.8, 1.8))
    box = shapely.affinity.rotate(shapely.box(2.5, -0.2, 4.5, 0.2), 30)
    expected = shapely.union_all([room, box, shapely.Point(-4, 1).buffer(0.5, quad_segs=32)])
    assert world.obstacles.symmetric_difference(expected).area == pytest.approx(0, abs=1e-9)
    assert (world.name, world.description) == ("mine", "a room")
    assert (world.start, world.goal, world.bounds) == ((0, 0, 0), (4, 4, 1.5), (-5, -5, 5, 5))
    opened = world_from({**EMPTY, "walls": [{"path": path, "thickness": 0.4}]}, "open")
    assert opened.clearance(-2, 0) == pytest.approx(1.8)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"drawing": "#..#"}, ["no start", "start:", "an S"]),
        ({"start": [0, 0, 0]}, ["without obstacles", "bounds"]),
        ({**EMPTY, "boxs": []}, ["unknown key", "'boxs'", "did you mean 'boxes'", "walls"]),
        ({**EMPTY, "boxes": [{"center": [3, 3], "size": [1, 1]}]}, ["boxes.0.center", "(and centre is missing)"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3], "size": [1, -1]}]}, ["boxes.0.size.1", "greater than 0", "-1"]),
        ({**EMPTY, "start": [0, 0]}, ["start: must be [x, y, yaw]", "got [0, 0]"]),
        ({**EMPTY, "start": [0, math.nan, 0]}, ["start.1", "finite", "nan"]),
        ("walls", ["mapping", "'walls'"]),
    ],
)
def test_a_mistake_in_a_description_is_one_line(content, words):
    with pytest.raises(InputError, match="world mine") as error:
        world_from(content, "mine")
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


# ---- drawings


def test_a_drawing_has_its_origin_at_the_lower_left_and_its_marks_in_the_middle_of_their_cells():
    world = world_from({"drawing": DRAWING, "cell": 0.5}, "drawing")
    assert (world.start, world.goal) == ((0.75, 1.25, 0), (1.75, 1.25, 0))
    assert world.bounds == (0, 0, 2.5, 2)
    assert world.free_space(0.0).bounds == pytest.approx((0.5, 0.5, 2, 1.5))
    assert len(world.boxes) == 4, "a row each below and above, a column each side"


def test_other_keys_of_a_file_take_precedence_over_its_drawing():
    posts = [{"centre": [9, 9], "radius": 1}]
    world = world_from({"drawing": DRAWING, "cell": 1.0, "start": [2.5, 1.5, 3.0], "posts": posts}, "mine")
    assert (world.start, world.goal) == ((2.5, 1.5, 3.0), (3.5, 2.5, 0.0))
    assert world.bounds == pytest.approx((0, 0, 10, 10))


@settings(derandomize=True, deadline=None, max_examples=10)
@given(st.lists(st.text("#.", min_size=1, max_size=8), min_size=1, max_size=6), st.sampled_from([0.5, 1.0]))
def test_every_hash_of_a_drawing_is_a_wall_and_nothing_else_is(lines, cell):
    world = world_from({"drawing": "\n".join(["S", *lines]), "cell": cell, "bounds": [0, 0, 9, 9]}, "random")
    for row, line in enumerate(reversed(lines)):
        for column, mark in enumerate(line):
            clearance = world.clearance((column + 0.5) * cell, (row + 0.5) * cell)
            assert clearance == 0 if mark == "#" else clearance >= cell / 2 - 1e-9
    assert world.obstacles.area == pytest.approx("".join(lines).count("#") * cell**2)


@pytest.mark.parametrize(
    ("drawing", "words"),
    [
        ("##\n#x", "has 'x' in line 2, column 2; it takes # (wall), S (start), G (goal), and . or a blank"),
        ("\n####\n#\tS#\n####", r"has '\t' in line 3, column 2;"),
        ("#####\n#S..#\n#..S#\n#####", "has a second S in line 3, column 4; the first is in line 2, column 2"),
    ],
)
def test_a_mistake_in_a_drawing_is_named_with_its_place(drawing, words):
    with pytest.raises(InputError, match=re.escape(f"world mine: the drawing {words}")) as error:
        world_from({"drawing": drawing}, "mine")
    assert "\n" not in str(error.value)
