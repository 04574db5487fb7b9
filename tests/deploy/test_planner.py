"""The way to a goal in a world that is known, told in the robot's own frame."""

from __future__ import annotations

import math

import pytest

from tb2rl.core.errors import InputError
from tb2rl.deploy import WorldPlanner
from tb2rl.worlds import World

RADIUS = 0.18


@pytest.fixture
def hall():
    """A hall with a wall across, open at its left end."""
    return World.from_shapes(
        "hall", boxes=[(2.0, -1.0, 0.2, 4.0, 0.0)], start=(0.0, 0.0, 0.0), bounds=(-3.0, -3.0, 5.0, 3.0)
    )


def test_the_way_leads_around_a_wall(hall):
    x, y = WorldPlanner(hall, RADIUS).ahead((0.0, 0.0, 0.0), (4.0, 0.0), 1.5)
    assert math.hypot(x, y) == pytest.approx(1.5, abs=0.1)
    assert y > 0.5


def test_the_goal_itself_is_told_where_it_is_near(hall):
    assert WorldPlanner(hall, RADIUS).ahead((0.0, 0.0, 0.0), (0.5, 0.5), 1.5) == pytest.approx((0.5, 0.5))


def test_points_are_told_where_the_odometry_counts_them(hall):
    planner = WorldPlanner(hall, RADIUS)
    expected = planner.lookahead_point((0.0, 0.0, 0.3), (4.0, 0.0), 1.5)
    turned = WorldPlanner(hall, RADIUS, origin=(1.0, 2.0, math.pi / 2))
    x, y = turned.ahead((-2.0, 1.0, 0.3), (-2.0, -3.0), 1.5)
    assert (1.0 - y, 2.0 + x) == pytest.approx(expected)


@pytest.mark.parametrize("goal", [(2.0, 0.0), (90.0, 0.0)])
def test_a_goal_inside_a_wall_or_outside_of_the_world_has_no_way(hall, goal):
    assert WorldPlanner(hall, RADIUS).ahead((0.0, 0.0, 0.0), goal, 1.5) is None


def test_a_goal_behind_a_closed_wall_has_no_way(hall):
    closed = World.from_shapes("closed", boxes=[(2.0, 0.0, 0.2, 6.0, 0.0)], start=(0.0, 0.0, 0.0), bounds=hall.bounds)
    assert WorldPlanner(closed, RADIUS).ahead((0.0, 0.0, 0.0), (4.0, 0.0), 1.5) is None


def test_a_world_is_named_as_in_a_config():
    assert WorldPlanner("wall", RADIUS).ahead((0.0, 0.0, 0.0), (0.5, 0.0), 1.5)
    with pytest.raises(InputError, match="unknown world"):
        WorldPlanner("hallway", RADIUS)
