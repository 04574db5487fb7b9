"""How far a robot can drive in several directions, held against driving there."""

import math

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots import Laser
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.sensors.laser import FreePaths


def test_it_is_as_long_as_a_circle_can_drive_in_small_steps(make_robot_state):
    laser = Laser(beams=40, field_of_view=math.tau)
    sensor = FreePaths(ROBOT, laser, count=9, spread=4.0, gap=0.05, bins=(0.5, 1.0))
    ranges = np.random.default_rng(0).uniform(0.23, 6.0, (50, 40))
    points = ranges[..., None] * np.stack([np.cos(laser.angles), np.sin(laser.angles)], axis=-1)
    free = sensor.read(make_robot_state(ranges=ranges))
    assert free.shape == (50, *sensor.shape) == (50, 9)
    ways = np.arange(0.0, sensor.high, 0.002)
    for direction, heading in enumerate(np.linspace(-2.0, 2.0, 9)):
        centres = ways[:, None] * (math.cos(heading), math.sin(heading))
        away = np.linalg.norm(points[:, None] - centres[:, None], axis=-1).min(axis=-1)  # (num_envs, ways)
        touched = away < ROBOT.radius + 0.05
        driven = np.where(touched.any(axis=1), ways[touched.argmax(axis=1)], sensor.high)
        np.testing.assert_allclose(free[:, direction], driven, atol=0.0025)
    assert 0.2 < (free < sensor.high).mean() < 0.8, "both kinds were tried"


def test_what_is_near_stops_it_and_what_is_behind_does_not(make_robot_state):
    laser = Laser(beams=4, field_of_view=math.tau)  # back, right, ahead, left
    sensor = FreePaths(ROBOT, laser, count=3, spread=1.0, bins=(1.0,))
    ranges = np.array([[np.inf] * 4, [0.1, np.inf, np.inf, np.inf], [np.inf, np.inf, 0.1, np.inf]])
    assert sensor.read(make_robot_state(ranges=ranges)).tolist() == [[2.0] * 3, [2.0] * 3, [0.0] * 3]


def test_it_looks_where_the_laser_looks():
    with pytest.raises(InputError, match="free paths span 120 degrees, but the laser only 90"):
        FreePaths(ROBOT, Laser(beams=9, field_of_view=math.pi / 2))
