"""A planned way, as a planner hands it over, and the point on it that a policy is to get to next."""

from __future__ import annotations

import math
from typing import Optional, Protocol

import numpy as np

from .policy_contract import Point, Pose, are_usable


class Planner(Protocol):
    """What knows the way to a goal."""

    def lookahead_point(self, pose: Pose, goal: Point, lookahead: float) -> Optional[Point]:
        """The point on the way that is `lookahead` [m] ahead of the robot, or the goal if it is nearer; None: no way.

        All in the odometry frame.
        """


class PlannedWay:
    """A way that stays as it is, such as a ROS nav_msgs/Path.

    Args:
        points: x, y [m] in the odometry frame, shape (points, 2), the goal last.

    Raises:
        ValueError: If that is not at least one point, or a number is not finite or larger than `LARGEST`.
    """

    def __init__(self, points: np.ndarray) -> None:
        self._points = np.array(points, dtype=float)
        if self._points.ndim != 2 or self._points.shape[1] != 2 or not len(self._points):
            raise ValueError(f"a planned way has the shape (points, 2), not {self._points.shape}")
        if not are_usable(self._points):
            raise ValueError("a planned way has a number that is not finite, or too large")
        self._steps = np.diff(self._points, axis=0)
        self._lengths = np.hypot(*self._steps.T)
        self._behind = np.concatenate([[0.0], np.cumsum(self._lengths)])  # way from the first point to each

    @property
    def end(self) -> Point:
        """Where it leads."""
        x, y = self._points[-1].tolist()
        return x, y

    def lookahead_point(self, pose: Pose, goal: Point, lookahead: float) -> Point:
        """See `Planner`; the way counts from where it is nearest to the robot."""
        at = self._nearest(np.array(pose[:2])) + lookahead
        x, y = (float(np.interp(at, self._behind, values)) for values in self._points.T)
        return x, y

    def _nearest(self, place: np.ndarray) -> float:
        """How far along the way the point is that is nearest to a place [m]."""
        if not self._behind[-1] > 0.0:
            return 0.0
        share = ((place - self._points[:-1]) * self._steps).sum(axis=1) / np.maximum(self._lengths, 1e-9) ** 2
        share = np.clip(share, 0.0, 1.0)
        away = place - self._points[:-1] - share[:, None] * self._steps
        best = int(np.argmin(np.hypot(*away.T)))
        return float(self._behind[best] + share[best] * self._lengths[best])


def distance(here: Point, there: Point) -> float:
    """Between two points [m]."""
    return math.hypot(there[0] - here[0], there[1] - here[1])
