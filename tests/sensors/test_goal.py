"""Distance and direction to the goal, by the wheels' odometry."""

import math

import numpy as np
import pytest

from tb2rl.sensors.goal import GoalBearing, GoalDistance

CASES = [  # odometry, distance [m], bearing [rad]
    ((0, 0, 0), 5, 0),
    ((5, -2, 0), 2, math.pi / 2),  # to the left: positive
    ((5, 2, 0), 2, -math.pi / 2),
    ((5, -2, math.pi / 2), 2, 0),
    ((4, -1, math.pi), math.sqrt(2), -3 * math.pi / 4),
    ((4, -1, -math.pi / 2), math.sqrt(2), 3 * math.pi / 4),
    ((4, 0, 3.0), 1, -3.0),
    ((6, 0, -3.0), 1, 3.0 - math.pi),
]


def test_distance_and_bearing_are_those_from_the_odometry(make_robot_state):
    odometry, distances, bearings = zip(*CASES, strict=True)
    lost = make_robot_state(pose=[(-7, 8, 1)] * len(CASES), odometry=odometry, goal=(5.0, 0.0))
    assert GoalDistance().read(lost)[:, 0] == pytest.approx(distances)
    assert GoalBearing().read(lost)[:, 0] == pytest.approx(bearings)


def test_a_bearing_stays_within_its_limits(make_robot_state):
    yaws, sensor = np.linspace(-math.pi, math.pi, 1001), GoalBearing()
    bearings = sensor.read(make_robot_state(pose=[(0, 0, yaw) for yaw in yaws], goal=(5.0, 0.0)))
    assert bearings.shape == (1001, 1)
    assert ((bearings >= sensor.low) & (bearings <= sensor.high)).all()
