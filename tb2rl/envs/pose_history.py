"""Recent poses: they lead a robot out of a dead end that its laser does not recognise."""

from __future__ import annotations

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.envs.episode_state import EpisodeState
from tb2rl.simulation import RobotState

_KEPT = 64.0  # [s]


class PoseHistory(EpisodeState):
    """Positions of the last minute by odometry, about one a second.

    Args:
        period: Control period [s].
    """

    field = "pose_history"

    def __init__(self, period: float) -> None:
        super().__init__()
        self._every = max(1, round(1.0 / period))
        self._seconds = self._every * period  # between two positions
        self._kept = max(1, round(_KEPT / self._seconds))

    def blank(self, num_envs: int) -> dict[str, np.ndarray]:
        return {"positions": np.full((num_envs, self._kept, 2), np.inf), "steps": np.zeros(num_envs, dtype=np.int64)}

    def update(self, robot_state: RobotState) -> None:
        steps = self._rows["steps"]
        due = np.flatnonzero(steps % self._every == 0)
        self._rows["positions"][due, steps[due] // self._every % self._kept] = robot_state.odometry[due, :2]
        steps += 1

    def seconds_near(self, points: np.ndarray, radius: float) -> np.ndarray:
        """Time within `radius` [m] of points x, y, shape (num_envs, n, 2): [s], shape (num_envs, n)."""
        counts = np.empty(points.shape[:2])
        _count(self._rows["positions"], points, radius, counts)
        return self._seconds * counts


@njit(cache=True, **UNCOUNTED)
def _count(positions, points, radius, counts):
    """Count the positions (num_envs, kept, 2) near each point (num_envs, n, 2)."""
    for i in range(counts.shape[0]):
        for point in range(counts.shape[1]):
            x, y, count = points[i, point, 0], points[i, point, 1], 0
            for k in range(positions.shape[1]):
                east, north = positions[i, k, 0] - x, positions[i, k, 1] - y
                count += east * east + north * north < radius * radius
            counts[i, point] = count
