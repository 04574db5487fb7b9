"""Where the goal is, as the robot believes by its wheels' odometry."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.values import Bins
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState

DISTANCE_BINS: Bins = (0.3, 0.6, 1.0, 2.0, 3.5)  # [m]
BEARING_BINS: Bins = (-2.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0)  # [rad]


class GoalDistance(Sensor):
    """How far the goal is [m].

    Args:
        bins: Borders of the distance classes [m].
    """

    name, unit = "goal distance", "m"
    low, high = 0.0, 100.0

    def __init__(self, bins: Bins = DISTANCE_BINS) -> None:
        self.bins = bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        return np.hypot(*_to_goal(robot_state))[:, None]


class GoalBearing(Sensor):
    """In which direction the goal is, counted from straight ahead [rad].

    Args:
        bins: Borders of the classes of angles [rad].
    """

    name, unit = "goal bearing", "rad"
    low, high = -math.pi, math.pi

    def __init__(self, bins: Bins = BEARING_BINS) -> None:
        self.bins = bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        return (np.remainder(_bearing(robot_state) + math.pi, math.tau) - math.pi)[:, None]


class GoalDirection(Sensor):
    """Cosine and sine of the direction in which the goal is: two numbers that make no jump behind the robot."""

    name, shape = "goal direction", (2,)
    low, high = -1.0, 1.0
    bins = (-0.7, 0.0, 0.7)

    def read(self, robot_state: RobotState) -> np.ndarray:
        bearing = _bearing(robot_state)
        return np.column_stack([np.cos(bearing), np.sin(bearing)])


def _to_goal(robot_state: RobotState) -> np.ndarray:
    """How far the goal is along x and along y of the odometry's frame [m], shape (2, robots)."""
    return (robot_state.goal - robot_state.odometry[:, :2]).T


def _bearing(robot_state: RobotState) -> np.ndarray:
    """Its direction, counted from straight ahead [rad], shape (num_envs,); any number of whole turns more or less."""
    east, north = _to_goal(robot_state)
    return np.arctan2(north, east) - robot_state.odometry[:, 2]
