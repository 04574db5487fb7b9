"""A planned path in the odometry frame, such as a nav_msgs/Path of ROS."""

from __future__ import annotations

import numpy as np

from .policy_contract import Point, Pose, are_usable


class PlannedPath:
    """A path that stays as it is.

    Args:
        points: x, y [m] in the odometry frame, shape (points, 2), the goal last.

    Raises:
        ValueError: If there is no point, or a number is not finite or is larger than `LARGEST`.
    """

    def __init__(self, points: np.ndarray) -> None:
        self._points = np.array(points, dtype=float)
        if self._points.ndim != 2 or self._points.shape[1] != 2 or not len(self._points):
            raise ValueError(f"a plan has the shape (points, 2), not {self._points.shape}")
        if not are_usable(self._points):
            raise ValueError("a plan has a number that is not finite, or too large")
        self._steps = np.diff(self._points, axis=0)
        self._lengths = np.hypot(*self._steps.T)
        self._distances = np.concatenate([[0.0], np.cumsum(self._lengths)])  # of each point along the path

    @property
    def end(self) -> Point:
        """The last point."""
        x, y = self._points[-1].tolist()
        return x, y

    def lookahead_point(self, pose: Pose, lookahead: float) -> Point:
        """The point `lookahead` [m] along the path from its point nearest to the robot, at most its end."""
        distance = self._nearest(np.array(pose[:2])) + lookahead
        x, y = (float(np.interp(distance, self._distances, values)) for values in self._points.T)
        return x, y

    def _nearest(self, place: np.ndarray) -> float:
        """The distance along the path of its point nearest to a place [m]."""
        if not self._distances[-1] > 0.0:
            return 0.0
        share = ((place - self._points[:-1]) * self._steps).sum(axis=1) / np.maximum(self._lengths, 1e-9) ** 2
        share = np.clip(share, 0.0, 1.0)
        away = place - self._points[:-1] - share[:, None] * self._steps
        best = int(np.argmin(np.hypot(*away.T)))
        return float(self._distances[best] + share[best] * self._lengths[best])
