"""Where the robot has been lately: a memory for policies that have none."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.values import Positive
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState

_MOST = 10.0  # [s]
_APART = 0.5  # of the distance: so near to a place counts as there


class Visited(Sensor):
    """How long the robot has been at some places around it within the last minute [s], by its odometry.

    First the places on a circle, counter-clockwise from straight ahead, then where the robot is, then those on a circle
    of twice the size. So a policy without a memory tells the way back from the way on: the idea of node counting
    (Koenig & Szymanski 1999, "Value-update rules for real-time search").

    Args:
        count: Of places on each circle.
        distance: Radius of the smaller circle [m].

    Attributes:
        around: The places in the robot's frame, x and y [m], shape (2 * count + 1, 2).
        near: How near to a place counts as there [m].
    """

    name, unit, low, high = "visited", "s", 0.0, _MOST
    bins = (1.0, 3.0)
    reads_pose_history = True

    def __init__(self, count: Annotated[int, Ge(1), Le(100)] = 12, distance: Positive = 1.0) -> None:
        angles = np.arange(count) * math.tau / count
        circle = distance * np.column_stack([np.cos(angles), np.sin(angles)])
        self.around = np.vstack([circle, (0.0, 0.0), 2.0 * circle])
        self.near, self.shape = _APART * distance, (len(self.around),)

    def read(self, robot_state: RobotState) -> np.ndarray:
        if robot_state.pose_history is None:
            return np.zeros((len(robot_state.odometry), *self.shape))
        (x, y, yaw), (ahead, left) = robot_state.odometry.T[:, :, None], self.around.T
        cos, sin = np.cos(yaw), np.sin(yaw)
        places = np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1)
        return robot_state.pose_history.seconds_near(places, self.near)
