"""Where the goal is, as the robot believes by its wheels' odometry."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.values import Edges
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import Reading

DISTANCE_EDGES: Edges = (0.3, 0.6, 1.0, 2.0, 3.5)  # [m]
BEARING_EDGES: Edges = (-2.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0)  # [rad]


class GoalDistance(Sensor):
    """How far the goal is [m].

    Args:
        edges: Borders of the distance classes [m].
    """

    name, unit = "goal distance", "m"
    low, high = 0.0, 100.0

    def __init__(self, edges: Edges = DISTANCE_EDGES) -> None:
        self.edges = edges

    def read(self, reading: Reading) -> np.ndarray:
        return np.hypot(*_to_goal(reading))[:, None]


class GoalBearing(Sensor):
    """In which direction the goal is, counted from straight ahead [rad].

    Args:
        edges: Borders of the classes of angles [rad].
    """

    name, unit = "goal bearing", "rad"
    low, high = -math.pi, math.pi

    def __init__(self, edges: Edges = BEARING_EDGES) -> None:
        self.edges = edges

    def read(self, reading: Reading) -> np.ndarray:
        return (np.remainder(_bearing(reading) + math.pi, math.tau) - math.pi)[:, None]


class GoalDirection(Sensor):
    """Cosine and sine of the direction in which the goal is: two numbers that make no jump behind the robot."""

    name, shape = "goal direction", (2,)
    low, high = -1.0, 1.0
    edges = (-0.7, 0.0, 0.7)

    def read(self, reading: Reading) -> np.ndarray:
        bearing = _bearing(reading)
        return np.column_stack([np.cos(bearing), np.sin(bearing)])


def _to_goal(reading: Reading) -> np.ndarray:
    """How far the goal is along x and along y of the odometry's frame [m], shape (2, robots)."""
    return (reading.goal - reading.odometry[:, :2]).T


def _bearing(reading: Reading) -> np.ndarray:
    """Its direction, counted from straight ahead [rad], shape (robots,); any number of whole turns more or less."""
    east, north = _to_goal(reading)
    return np.arctan2(north, east) - reading.odometry[:, 2]
