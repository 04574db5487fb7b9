"""What the sensors of all robots say at one instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tb2rl.simulation.start import Start
from tb2rl.worlds.geometry import shortest


@dataclass(frozen=True)
class Reading:
    """What the robots sense, the truth beside it, and the start of the episode that each is in.

    Attributes:
        pose: True x [m], y [m], yaw [rad] in the world's frame, shape (robots, 3).
        twist: True forward speed [m/s] and turn rate [rad/s], shape (robots, 2).
        odometry: x, y, yaw counted from the wheels since the start pose, shape (robots, 3).
        ranges: Distances along the laser's beams [m], right to left, inf where nothing was hit, shape (robots, beams).
        bumped: Whether the base touched a wall since the last reading, shape (robots,), bool.
        start: How the episode of each robot began: its world, its goal, its bounds.
    """

    pose: np.ndarray
    twist: np.ndarray
    odometry: np.ndarray
    ranges: np.ndarray
    bumped: np.ndarray
    start: Start

    @cached_property
    def nearest(self) -> np.ndarray:
        """The shortest range of each robot [m], shape (robots,)."""
        return shortest(self.ranges)

    @property
    def goal(self) -> np.ndarray:
        """Where each robot is to get, x, y [m], shape (robots, 2); NaN for a robot without a goal."""
        return self.start.goal

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Reading:
        """The reading whose `state` this is."""
        return cls(**{**state, "start": Start(np.array(state["start"]))})

    def state(self) -> dict[str, Any]:
        """All of it by name, in arrays of its own."""
        arrays = {name: np.array(getattr(self, name)) for name in ("pose", "twist", "odometry", "ranges", "bumped")}
        return {**arrays, "start": self.start.table.copy()}

    def some(self, robots: np.ndarray) -> Reading:
        """The rows of the robots with these indices."""
        return Reading(
            self.pose[robots],
            self.twist[robots],
            self.odometry[robots],
            self.ranges[robots],
            self.bumped[robots],
            Start(self.start.table[robots]),
        )
