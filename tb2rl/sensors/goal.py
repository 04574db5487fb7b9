"""Sensors of the goal, by odometry, and of the lookahead point on the planned path to the goal.

The planner uses the map of the world and the robot's exact pose, or a map that the robot builds online and the pose
that it estimates by odometry and scan matching.
"""

import math
from typing import Annotated

import numpy as np
from annotated_types import Le

from tb2rl.core.values import Bins, Positive
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState

DISTANCE_BINS: Bins = (0.3, 0.6, 1.0, 2.0, 3.5)  # [m]
BEARING_BINS: Bins = (-2.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0)  # [rad]
WAYPOINT_BEARING_BINS: Bins = (-1.2, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.2)  # [rad]
LOOKAHEAD = 1.5  # [m] default distance of the lookahead point
Lookahead = Annotated[Positive, Le(100)]  # [m] limited because the computing time of `read` grows with it


class GoalDistance(Sensor):
    """Distance to the goal [m], with `bins` [m]."""

    name, unit, low, high = "goal distance", "m", 0.0, 100.0

    def __init__(self, bins: Bins = DISTANCE_BINS) -> None:
        self.bins = bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        return np.hypot(*(robot_state.goal - robot_state.odometry[:, :2]).T)[:, None]


class GoalBearing(Sensor):
    """Bearing of the goal: the angle from straight ahead, positive to the left [rad], with `bins` [rad]."""

    name, unit, low, high = "goal bearing", "rad", -math.pi, math.pi

    def __init__(self, bins: Bins = BEARING_BINS) -> None:
        self.bins = bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        return (np.remainder(_bearing(robot_state) + math.pi, math.tau) - math.pi)[:, None]


class GoalDirection(Sensor):
    """Cosine and sine of the goal's bearing, which are continuous, unlike the bearing of a goal behind the robot."""

    name, shape, low, high = "goal direction", (2,), -1.0, 1.0
    bins = (-0.7, 0.0, 0.7)

    def read(self, robot_state: RobotState) -> np.ndarray:
        bearing = _bearing(robot_state)
        return np.column_stack([np.cos(bearing), np.sin(bearing)])


def _bearing(robot_state: RobotState) -> np.ndarray:
    """Bearing of the goal [rad], shape (num_envs,), not wrapped to [-pi, pi]."""
    x, y = (robot_state.goal - robot_state.odometry[:, :2]).T
    return np.arctan2(y, x) - robot_state.odometry[:, 2]


class PathLength(Sensor):
    """Length of the shortest path to the goal [m], by the map of the world, with `bins` [m]."""

    name, unit, low, high = "path length", "m", 0.0, 100.0

    def __init__(self, bins: Bins = DISTANCE_BINS) -> None:
        self.bins = bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.path_length[:, None]


class Waypoint(Sensor):
    """The lookahead point on the planned path, x ahead and y to the left of the robot [m].

    Args:
        lookahead: Distance from the robot along the path [m]; the point is the goal if the path is shorter.
        bins: Borders between bins [m].
    """

    name, unit, shape = "waypoint", "m", (2,)

    def __init__(self, lookahead: Lookahead = LOOKAHEAD, bins: Bins = (-0.5, -0.15, 0.15, 0.5)) -> None:
        self.low, self.high, self.lookahead, self.bins = -lookahead, lookahead, lookahead, bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        x, y = (robot_state.lookahead_point(self.lookahead) - robot_state.pose[:, :2]).T
        cos, sin = np.cos(robot_state.pose[:, 2]), np.sin(robot_state.pose[:, 2])
        return np.column_stack([cos * x + sin * y, cos * y - sin * x])


class WaypointBearing(Waypoint):
    """Bearing of the lookahead point: the angle from straight ahead, positive to the left [rad], with `bins` [rad]."""

    name, unit, shape = "waypoint bearing", "rad", (1,)

    def __init__(self, lookahead: Lookahead = LOOKAHEAD, bins: Bins = WAYPOINT_BEARING_BINS) -> None:
        super().__init__(lookahead, bins)
        self.low, self.high = -math.pi, math.pi

    def read(self, robot_state: RobotState) -> np.ndarray:
        ahead, left = super().read(robot_state).T
        return np.arctan2(left, ahead)[:, None]
