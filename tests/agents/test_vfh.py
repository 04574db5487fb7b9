"""VFH+ turns to the best of the directions that are free for the width of the robot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tb2rl.agents.vfh import VFH


def side_walls(width: float) -> list[tuple[float, float, float]]:
    """A wall across the path, 1 m ahead, with a door of this width in the middle [m]."""
    ends = np.arange(width / 2.0 + 0.05, 3.0, 0.05)
    return [(1.0, side * y, 0.05) for y in ends for side in (-1.0, 1.0)]


def test_it_turns_to_a_free_target_at_its_gain(playground):
    direction = math.radians(23.0)
    target = (1.5 * math.cos(direction), 1.5 * math.sin(direction))
    v, w = playground(target).command(VFH, gain=2.0, spin=1.0)
    assert w == pytest.approx(2.0 * direction, rel=1e-4)
    assert v == pytest.approx(0.65 * (1.0 - direction), rel=1e-4)


def test_it_passes_a_door_as_wide_as_it_needs(playground):
    for width, passes in ((0.3, False), (0.6, True)):
        path, clearance = playground((2.5, 0.3), side_walls(width)).drive(VFH, steps=150)
        assert clearance > 0.178
        assert (path[:, 0].max() > 1.5) == passes


def test_it_takes_the_middle_of_a_narrow_valley(playground):
    walls = [(x, side * 0.45, 0.05) for x in np.arange(0.0, 2.0, 0.05) for side in (-1.0, 1.0)]
    v, w = playground((1.4, 0.3), walls).command(VFH)
    assert abs(w) < 0.1
    assert v > 0.5


def test_it_keeps_turning_to_the_same_side(playground):
    wall = [(0.35, y, 0.05) for y in np.arange(-1.0, 1.01, 0.04)]
    floor = playground((1.5, 0.0), wall)
    for turn in (-1.0, 1.0):
        assert floor.command(VFH, (0.0, turn))[1] * turn > 1.0


def test_it_prefers_the_previous_direction(playground):
    floor = playground((1.5, 0.0), [(0.7, 0.0, 0.1)])
    assert floor.command(VFH, (0.5, 1.5))[1] > 0.5
    assert floor.command(VFH, (0.5, -1.5))[1] < -0.5
