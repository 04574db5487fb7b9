"""Where the planned way leads: a point on it some way ahead, as navigation stacks hand it to what drives.

The planner knows where the robot is on its map, as a localised robot does: on the world's own, or on what was seen.
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
Lookahead = Annotated[Positive, Le(100)]  # a way is followed step by step


class Waypoint(Sensor):
    """Where the point of the way is that the robot is to get to next: so far ahead, and so far to the left [m].

    Args:
        lookahead: How far ahead on the way it is [m]; the goal, where that is nearer.
        bins: Borders of the classes of both numbers [m].
    """

    name, unit, shape = "waypoint", "m", (2,)

    def __init__(self, lookahead: Lookahead = LOOKAHEAD, bins: Bins = (-0.5, -0.15, 0.15, 0.5)) -> None:
        self.low, self.high, self.lookahead, self.bins = -lookahead, lookahead, lookahead, bins

    def read(self, robot_state: RobotState) -> np.ndarray:
        east, north = (robot_state.lookahead_point(self.lookahead) - robot_state.pose[:, :2]).T
        cos, sin = np.cos(robot_state.pose[:, 2]), np.sin(robot_state.pose[:, 2])
        return np.column_stack([cos * east + sin * north, cos * north - sin * east])


class WaypointBearing(Sensor):
    """In which direction that point is, counted from straight ahead [rad]: one number, for tables.

    Args:
        lookahead: As of `Waypoint` [m].
        bins: Borders of the classes of angles [rad].
    """

    name, unit = "waypoint bearing", "rad"
    low, high = -math.pi, math.pi

    def __init__(
        self, lookahead: Lookahead = LOOKAHEAD, bins: Bins = (-1.2, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.2)
    ) -> None:
        self.bins, self.lookahead, self._waypoint = bins, lookahead, Waypoint(lookahead)

    def read(self, robot_state: RobotState) -> np.ndarray:
        ahead, left = self._waypoint.read(robot_state).T
        return np.arctan2(left, ahead)[:, None]
