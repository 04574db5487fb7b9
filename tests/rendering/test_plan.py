"""Plans of worlds, and sheets of many."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.rendering.colours import BODY, FREE, GOAL, WALL
from tb2rl.rendering.plan import draw_plan, sheet
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds.registry import find_world
from tb2rl.worlds.world import World


def share(picture, colour):
    """How much of a picture has a colour."""
    return (picture == ImageColor.getrgb(colour)).all(axis=2).mean()


def test_a_plan_shows_walls_and_where_the_robot_can_get_to_and_its_start_and_goal():
    picture = draw_plan(find_world("maze"), ROBOT)
    assert (picture.dtype, picture.shape[2]) == (np.uint8, 3)
    for colour, least in ((WALL, 0.02), (FREE, 0.5), (BODY, 5e-4), (GOAL, 1e-4)):
        assert share(picture, colour) > least


@pytest.mark.parametrize(("door", "least", "most"), [(1.0, 0.5, 0.9), (0.2, 0.2, 0.45)])
def test_a_room_behind_a_narrow_door_is_not_free(door, least, most):
    side = (4 - door) / 2
    walls = [(4, side / 2, 0.2, side, 0), (4, 4 - side / 2, 0.2, side, 0)]
    world = World.from_shapes("door", walls, start=(2, 2, 0), bounds=(0, 0, 8, 4))
    assert least < share(draw_plan(world, ROBOT), FREE) < most


def test_a_sheet_holds_all_plans_and_one_alone_stays_as_it_is():
    plan = draw_plan(find_world("loop"), ROBOT)
    assert sheet([plan], ["loop"]) is plan
    picture = sheet([plan] * 5, list("abcde"), columns=5)
    assert picture.shape[1] == pytest.approx(5 * picture.shape[0], rel=0.1)
    five, two = share(picture, BODY) * picture.size, share(sheet([plan] * 2, ["a", "b"]), BODY)
    assert five > 0
    assert two > 0
