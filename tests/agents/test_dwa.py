"""The dynamic window approach takes reachable speeds from which the robot can stop."""

from __future__ import annotations

import numpy as np
import pytest

from tb2rl.agents.dwa import DWA
from tb2rl.robots.turtlebot2 import ROBOT


@pytest.mark.parametrize("speeds", [(0.0, 0.0), (0.3, 1.0), (0.65, -2.0)])
def test_it_commands_reachable_speeds(speeds, playground):
    for target in ((1.5, 0.0), (0.0, 1.0), (-1.0, -0.5)):
        v, w = playground(target).command(DWA, speeds, acceleration=1.0, turn_acceleration=6.0)
        assert abs(v - speeds[0]) <= 0.1 + 1e-6
        assert abs(w - speeds[1]) <= 0.6 + 1e-6


def test_it_accelerates_to_full_speed(playground):
    path, _ = playground((4.0, 0.0)).drive(DWA, steps=30)
    steps = np.hypot(*np.diff(path, axis=0).T)
    assert steps[0] == pytest.approx(0.01, abs=0.002)
    assert steps[-1] == pytest.approx(0.065, abs=0.002)


@pytest.mark.parametrize("v", [0.2, 0.4, 0.65])
def test_it_brakes_while_it_still_can(v, playground):
    gap, brakes = 0.04, v * 0.1 + v**2 / 2.0
    for free in np.arange(0.05, 0.6, 0.05):
        wall = [(free + ROBOT.radius + gap + 0.05, y, 0.05) for y in np.arange(-1.5, 1.51, 0.04)]
        commanded = playground((3.0, 0.0), wall).command(DWA, (v, 0.0), gap=gap)[0]
        assert commanded <= v - 0.1 + 1e-6 or brakes - 0.11 <= free


def test_weights_decide_between_target_and_speed(playground):
    floor = playground((0.0, 1.5))
    aims = floor.command(DWA, (0.3, 0.0), heading=5.0, speed=0.0, progress=0.0, clearance=0.0)
    hurries = floor.command(DWA, (0.3, 0.0), heading=0.0, speed=5.0, progress=0.0, clearance=0.0)
    assert aims[1] == pytest.approx(0.6, abs=1e-5)
    assert hurries[0] == pytest.approx(0.4, abs=1e-5)


def test_it_rotates_away_from_a_wall_to_one_side(playground):
    wall = [(0.3, y, 0.05) for y in np.arange(-0.5, 0.51, 0.04)]
    floor = playground((1.5, 0.0), wall)
    for turn in (-1.0, 1.0):
        v, w = floor.command(DWA, (0.0, turn))
        assert v == pytest.approx(0.0, abs=1e-6)
        assert w == pytest.approx(2.0 * turn)
