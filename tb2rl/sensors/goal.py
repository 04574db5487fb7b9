"""The goal relative to the robot, by odometry."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.values import Bins
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState

DISTANCE_BINS: Bins = (0.3, 0.6, 1.0, 2.0, 3.5)  # [m]
BEARING_BINS: Bins = (-2.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0)  # [rad]


class GoalDistance(Sensor):
    """Distance to the goal [m]; `bins` are in metres, too."""

    name, unit = "goal distance", "m"
    low, high = 0.0, 100.0

    def __init__(self, bins: Bins = DISTANCE_BINS) -> None:
        self.bins = bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        return np.hypot(*(robot_state.goal - robot_state.odometry[:, :2]).T)[:, None]


class GoalBearing(Sensor):
    """Bearing of the goal: the angle from straight ahead, positive to the left [rad]; `bins` likewise."""

    name, unit = "goal bearing", "rad"
    low, high = -math.pi, math.pi

    def __init__(self, bins: Bins = BEARING_BINS) -> None:
        self.bins = bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        return (np.remainder(_bearing(robot_state) + math.pi, math.tau) - math.pi)[:, None]


class GoalDirection(Sensor):
    """Cosine and sine of the goal's bearing, which do not jump behind the robot."""

    name, shape = "goal direction", (2,)
    low, high = -1.0, 1.0
    bins = (-0.7, 0.0, 0.7)

    def read(self, robot_state: RobotState) -> np.ndarray:
        bearing = _bearing(robot_state)
        return np.column_stack([np.cos(bearing), np.sin(bearing)])


def _bearing(robot_state: RobotState) -> np.ndarray:
    """Bearing of the goal [rad], shape (num_envs,), not normalised."""
    x, y = (robot_state.goal - robot_state.odometry[:, :2]).T
    return np.arctan2(y, x) - robot_state.odometry[:, 2]
