"""Worlds as text drawings."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tb2rl.core.errors import InputError
from tb2rl.worlds.description import world_from
from tb2rl.worlds.drawing import read_drawing

DRAWING = """
#####
#S.G#
#...#
#####
"""


def test_a_drawing_has_its_origin_at_the_lower_left_and_its_marks_in_the_middle_of_their_cells():
    world = world_from({"drawing": DRAWING, "cell": 0.5}, "drawing")
    assert (world.start, world.goal) == ((0.75, 1.25, 0), (1.75, 1.25, 0))
    assert world.bounds == (0, 0, 2.5, 2)
    assert world.free_space(0.0).bounds == pytest.approx((0.5, 0.5, 2, 1.5))


def test_equal_runs_of_a_drawing_become_one_box():
    assert len(read_drawing(DRAWING, 2.0).boxes) == 4  # a row each below and above, a column each side
    assert len(read_drawing("#S..#\n#.###\n#.###\n#####", 2.0).boxes) == 4


def test_a_blank_and_a_dot_are_free_floor():
    assert read_drawing("#####\n#S  #\n#####", 2.0) == read_drawing("#####\n#S..#\n#####", 2.0)


@pytest.mark.parametrize(
    ("drawing", "words"),
    [
        (
            "#####\n#S.x#\n#####",
            "has 'x' in line 2, column 4; it takes # (wall), S (start), G (goal), and . or a blank",
        ),
        ("#####\n#Sé.#\n#####", "has 'é' in line 2, column 3;"),
        ("\n####\n#\tS#\n####", r"has '\t' in line 3, column 2;"),
        ("####\n#S #\n####\t", r"has '\t' in line 3, column 5;"),
        ("####\n#S.#\x0c\n####", r"has '\x0c' in line 2, column 5;"),
        ("####\n#s.#\n####", "has 's' in line 2, column 2;"),
        ("#####\n#S..#\n#..S#\n#####", "has a second S in line 3, column 4; the first is in line 2, column 2"),
        ("#####\n#SGG#\n#####", "has a second G in line 2, column 4; the first is in line 2, column 3"),
    ],
)
def test_what_does_not_belong_into_a_drawing_is_refused_with_its_place(drawing, words):
    with pytest.raises(InputError, match=re.escape(f"world mine: the drawing {words}")) as error:
        world_from({"drawing": drawing}, "mine")
    assert "\n" not in str(error.value)


def test_a_drawing_without_marks_has_neither_start_nor_goal():
    drawn = read_drawing("#..#", 1.0)
    assert (drawn.start, drawn.goal, len(drawn.boxes)) == (None, None, 2)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.lists(st.text("#.", min_size=1, max_size=8), min_size=1, max_size=6), st.sampled_from([0.5, 1.0]))
def test_every_mark_of_a_drawing_is_a_wall_and_nothing_else_is(lines, cell):
    world = world_from({"drawing": "\n".join(["S", *lines]), "cell": cell, "bounds": [0, 0, 9, 9]}, "random")
    for row, line in enumerate(reversed(lines)):
        for column, mark in enumerate(line):
            clearance = world.clearance((column + 0.5) * cell, (row + 0.5) * cell)
            assert clearance == 0 if mark == "#" else clearance >= cell / 2 - 1e-9
    assert world.obstacles.area == pytest.approx("".join(lines).count("#") * cell**2)


def test_a_drawing_too_narrow_for_the_robot_has_no_free_space():
    world = world_from({"drawing": "###\n#S#\n###", "cell": 0.3}, "mine")
    with pytest.raises(InputError, match=r"world mine: .*no free space"):
        world.free_space(0.178)
