"""A point ahead on the planned path, as navigation stacks give it to a path follower.

The planner knows the robot's pose on its map: the map of the world, or one that the robot builds online.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Le

from tb2rl.core.values import Bins, Positive
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState

LOOKAHEAD = 1.5  # [m]
BEARING_BINS: Bins = (-1.2, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.2)  # [rad]
Lookahead = Annotated[Positive, Le(100)]  # [m] limited, because a path is followed step by step


class Waypoint(Sensor):
    """The lookahead point on the planned path: x ahead, y to the left [m].

    Args:
        lookahead: Distance along the path [m]; a goal that is nearer takes its place.
        bins: Borders of the bins of both coordinates [m].
    """

    name, unit, shape = "waypoint", "m", (2,)

    def __init__(self, lookahead: Lookahead = LOOKAHEAD, bins: Bins = (-0.5, -0.15, 0.15, 0.5)) -> None:
        self.low, self.high, self.lookahead, self.bins = -lookahead, lookahead, lookahead, bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        x, y = (robot_state.lookahead_point(self.lookahead) - robot_state.pose[:, :2]).T
        cos, sin = np.cos(robot_state.pose[:, 2]), np.sin(robot_state.pose[:, 2])
        return np.column_stack([cos * x + sin * y, cos * y - sin * x])


class WaypointBearing(Waypoint):
    """Bearing of the lookahead point: the angle from straight ahead, positive to the left [rad]; `bins` likewise."""

    name, unit, shape = "waypoint bearing", "rad", (1,)

    def __init__(self, lookahead: Lookahead = LOOKAHEAD, bins: Bins = BEARING_BINS) -> None:
        super().__init__(lookahead, bins)
        self.low, self.high = -math.pi, math.pi

    def read(self, robot_state: RobotState) -> np.ndarray:
        ahead, left = super().read(robot_state).T
        return np.arctan2(left, ahead)[:, None]
