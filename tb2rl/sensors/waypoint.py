"""Where the planned way leads: a point on it some way ahead, as navigation stacks hand it to what drives.

The planner knows where the robot is on its map, as a localised robot does: on the world's own, or on what was seen.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Le

from tb2rl.core.values import Edges, Positive
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import Reading

REACH = 1.5  # [m]
Reach = Annotated[Positive, Le(100)]  # a way is followed step by step


class Waypoint(Sensor):
    """Where the point of the way is that the robot is to get to next: so far ahead, and so far to the left [m].

    Args:
        reach: How far ahead on the way it is [m]; the goal, where that is nearer.
        edges: Borders of the classes of both numbers [m].
    """

    name, unit, shape = "waypoint", "m", (2,)

    def __init__(self, reach: Reach = REACH, edges: Edges = (-0.5, -0.15, 0.15, 0.5)) -> None:
        self.low, self.high, self.reach, self.edges = -reach, reach, reach, edges

    def read(self, reading: Reading) -> np.ndarray:
        east, north = (reading.ahead(self.reach) - reading.pose[:, :2]).T
        cos, sin = np.cos(reading.pose[:, 2]), np.sin(reading.pose[:, 2])
        return np.column_stack([cos * east + sin * north, cos * north - sin * east])


class WaypointBearing(Sensor):
    """In which direction that point is, counted from straight ahead [rad]: one number, for tables.

    Args:
        reach: As of `Waypoint` [m].
        edges: Borders of the classes of angles [rad].
    """

    name, unit = "waypoint bearing", "rad"
    low, high = -math.pi, math.pi

    def __init__(self, reach: Reach = REACH, edges: Edges = (-1.2, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.2)) -> None:
        self.edges, self.reach, self._waypoint = edges, reach, Waypoint(reach)

    def read(self, reading: Reading) -> np.ndarray:
        ahead, left = self._waypoint.read(reading).T
        return np.arctan2(left, ahead)[:, None]
