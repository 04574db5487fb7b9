"""A memory of visited places, for policies without one."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.values import Positive
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class Visited(Sensor):
    """Time spent within the last minute at places around the robot [s], by odometry.

    The places are on a circle, counter-clockwise from straight ahead; then at the robot's position; then on a circle of
    twice the radius. They tell a policy the way back from the way on, as node counting does (Koenig & Szymanski 1999,
    "Value-update rules for real-time search").

    Args:
        count: Number of places on each circle.
        distance: Radius of the smaller circle [m].

    Attributes:
        around: Places in the robot's frame, x and y [m], shape (2 * count + 1, 2).
        near: Distance to a place that counts as there [m].
    """

    name, unit, low, high = "visited", "s", 0.0, 10.0
    bins = (1.0, 3.0)
    reads_pose_history = True

    def __init__(self, count: Annotated[int, Ge(1), Le(100)] = 12, distance: Positive = 1.0) -> None:
        angles = np.arange(count) * math.tau / count
        circle = distance * np.column_stack([np.cos(angles), np.sin(angles)])
        self.around = np.vstack([circle, (0.0, 0.0), 2.0 * circle])
        self.near, self.shape = 0.5 * distance, (len(self.around),)

    def read(self, robot_state: RobotState) -> np.ndarray:
        if robot_state.pose_history is None:
            return np.zeros((len(robot_state.odometry), *self.shape))
        (x, y, yaw), (ahead, left) = robot_state.odometry.T[:, :, None], self.around.T
        cos, sin = np.cos(yaw), np.sin(yaw)
        places = np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1)
        return robot_state.pose_history.seconds_near(places, self.near)
