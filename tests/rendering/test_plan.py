"""Plans of worlds, and grids of many."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.rendering.colours import BODY, FREE, GOAL, WALL
from tb2rl.rendering.plan import draw_plan, make_grid
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world


def share(picture, colour):
    """Share of a picture with a colour."""
    return (picture == ImageColor.getrgb(colour)).all(axis=2).mean()


def test_a_plan_shows_walls_reachable_space_start_and_goal():
    picture = draw_plan(find_world("maze"), ROBOT)
    assert (picture.dtype, picture.shape[2]) == (np.uint8, 3)
    for colour, least in ((WALL, 0.02), (FREE, 0.5), (BODY, 5e-4), (GOAL, 1e-4)):
        assert share(picture, colour) > least


@pytest.mark.parametrize(("door", "least", "most"), [(1.0, 0.5, 0.9), (0.2, 0.2, 0.45)])
def test_a_room_behind_a_narrow_door_is_not_reachable(door, least, most):
    side = (4 - door) / 2
    walls = [(4, side / 2, 0.2, side, 0), (4, 4 - side / 2, 0.2, side, 0)]
    world = World.from_shapes("door", walls, start=(2, 2, 0), bounds=(0, 0, 8, 4))
    assert least < share(draw_plan(world, ROBOT), FREE) < most


def test_a_grid_holds_all_plans_and_a_single_one_is_unchanged():
    plan = draw_plan(find_world("loop"), ROBOT)
    assert make_grid([plan], ["loop"]) is plan
    grid = make_grid([plan] * 5, list("abcde"), columns=5)
    assert grid.shape[1] == pytest.approx(5 * grid.shape[0], rel=0.1)
    for tile in np.split(grid, 5, axis=1):
        assert share(tile, BODY) > 0
