"""Worlds as YAML: walls, boxes and posts in metres, and what a file can get wrong."""

import math

import numpy as np
import pytest
import shapely

from tb2rl.core.errors import InputError
from tb2rl.worlds.description import world_from

EMPTY = {"start": [0, 0, 0], "bounds": [-5, -5, 5, 5]}


def test_walls_follow_their_path_with_their_thickness_and_filled_corners():
    path = [[-2, -2], [2, -2], [2, 2], [-2, 2]]
    world = world_from({**EMPTY, "walls": [{"path": path, "closed": True, "thickness": 0.4}]}, "square")
    ring = shapely.box(-2.2, -2.2, 2.2, 2.2).difference(shapely.box(-1.8, -1.8, 1.8, 1.8))
    assert world.obstacles.symmetric_difference(ring).area == pytest.approx(0, abs=1e-9)
    opened = world_from({**EMPTY, "walls": [{"path": path, "thickness": 0.4}]}, "open")
    assert world.clearance(-2, 0) == 0
    assert opened.clearance(-2, 0) == pytest.approx(1.8)


@pytest.mark.parametrize("degrees", [0, 30, 45, 80, 90, 135, 180, -60, 400])
def test_a_box_is_turned_by_its_yaw(degrees):
    yaw = math.radians(degrees)
    world = world_from({**EMPTY, "boxes": [{"centre": [2, 1], "size": [2, 0.4], "yaw": yaw}]}, "box")
    along, across = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    assert world.clearance(*((2, 1) + 0.99 * along)) == 0
    assert world.clearance(*((2, 1) + 1.5 * along)) == pytest.approx(0.5)
    assert world.clearance(*((2, 1) - 0.5 * across)) == pytest.approx(0.3)


def test_a_post_is_round_and_everything_else_is_as_it_was_said():
    said = {"posts": [{"centre": [2, 1], "radius": 0.5}], "goal": [4, 4, 1.5], "description": "one post"}
    world = world_from({**EMPTY, **said}, "mine")
    assert world.clearance(2, 3) == pytest.approx(1.5)
    assert (world.name, world.description) == ("mine", "one post")
    assert (world.start, world.goal, world.bounds) == ((0, 0, 0), (4, 4, 1.5), (-5, -5, 5, 5))


def test_the_world_of_a_drawing_takes_what_the_file_says_over_its_marks():
    drawn = {"drawing": "#####\n#S.G#\n#####", "cell": 1.0}
    world = world_from({**drawn, "start": [2.5, 1.5, 3.0], "posts": [{"centre": [9, 9], "radius": 1}]}, "mine")
    assert (world.start, world.goal) == ((2.5, 1.5, 3.0), (3.5, 1.5, 0.0))
    assert world.bounds == pytest.approx((0, 0, 10, 10))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"boxes": [{"centre": [1, 1], "size": [1, 1]}]}, ["no start", "start:"]),
        ({"drawing": "#..#"}, ["no start", "an S"]),
        ({"start": [0, 0, 0], "bounds": [5, 5, -5, -5]}, ["bounds"]),
        ({"start": [0, 0, 0]}, ["without obstacles", "bounds"]),
        ({**EMPTY, "boxs": []}, ["unknown key", "'boxs'", "did you mean 'boxes'", "walls"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3], "size": [1, 1], "sise": 2}]}, ["boxes.0", "sise"]),
        ({**EMPTY, "walls": [{"path": [[3, 3], [4, 4]], "thicknes": 2}]}, ["walls.0", "thicknes"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3]}]}, ["boxes.0.size", "required"]),
        ({**EMPTY, "boxes": [{"centre": [3, 3], "size": [1, -1]}]}, ["boxes.0.size.1", "greater than 0", "-1"]),
        ({**EMPTY, "posts": [{"centre": [3, 3], "radius": "wide"}]}, ["posts.0.radius", "number", "'wide'"]),
        ({**EMPTY, "walls": [{"path": [[1, 1]]}]}, ["walls.0.path", "at least 2"]),
        ({**EMPTY, "cell": 0}, ["cell", "greater than 0"]),
        ({**EMPTY, "start": [0, 0]}, ["start: must be [x, y, yaw]", "got [0, 0]"]),
        ({**EMPTY, "goal": [3, 2]}, ["goal: must be [x, y, yaw]", "got [3, 2]"]),
        ({**EMPTY, "boxes": [{"center": [3, 3], "size": [1, 1]}]}, ["boxes.0.center", "(and centre is missing)"]),
        ({**EMPTY, "start": [0, math.nan, 0]}, ["start.1", "finite", "nan"]),
        ({**EMPTY, "bounds": [-5, -5, math.inf, 5]}, ["bounds.2", "finite", "inf"]),
        ({**EMPTY, "boxes": [{"centre": [math.nan, 3], "size": [1, 1]}]}, ["boxes.0.centre.0", "finite", "nan"]),
        (["walls"], ["mapping", "['walls']"]),
        ("walls", ["mapping", "'walls'"]),
    ],
)
def test_a_wrong_description_is_refused_with_one_clear_line(content, words):
    with pytest.raises(InputError, match="world mine") as error:
        world_from(content, "mine")
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)
