"""A planned path in the odometry frame, such as a nav_msgs/Path of ROS."""

from __future__ import annotations

import numpy as np

from .policy_contract import Point, Pose, are_usable


class PlannedPath:
    """A fixed path to the goal, through points x, y [m] in the odometry frame, shape (points, 2), the goal last.

    Raises:
        ValueError: If there are no points, or a number is not finite, or larger than `MAX_MAGNITUDE`.
    """

    def __init__(self, points: np.ndarray) -> None:
        self._points = np.array(points, dtype=float)
        if self._points.ndim != 2 or self._points.shape[1] != 2 or not len(self._points):
            raise ValueError(f"a plan has shape {self._points.shape}; give (points, 2)")
        if not are_usable(self._points):
            raise ValueError("a plan has a number that is not finite, or too large")
        self._segments = np.diff(self._points, axis=0)
        self._lengths = np.hypot(*self._segments.T)
        self._distances = np.concatenate([[0.0], np.cumsum(self._lengths)])  # from the start of the path to each point

    @property
    def end(self) -> Point:
        """The last point."""
        return tuple(self._points[-1].tolist())

    def lookahead_point(self, pose: Pose, lookahead: float) -> Point:
        """The point on the path `lookahead` [m] beyond the point nearest to the robot, at most the end of the path."""
        distance = 0.0
        if self._distances[-1] > 0.0:
            offsets = np.array(pose[:2]) - self._points[:-1]  # from the start of each segment to the robot
            fractions = np.clip((offsets * self._segments).sum(axis=1) / np.maximum(self._lengths, 1e-9) ** 2, 0.0, 1.0)
            nearest = int(np.argmin(np.hypot(*(offsets - fractions[:, None] * self._segments).T)))
            distance = self._distances[nearest] + fractions[nearest] * self._lengths[nearest]
        x, y = (float(np.interp(distance + lookahead, self._distances, values)) for values in self._points.T)
        return x, y
