"""Episode states: histories, and the base class of maps, that last for an episode, besides the latest robot state."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.simulation import RobotState

_HISTORY_DURATION = 64.0  # [s] time that `PositionHistory` covers


class EpisodeState(ABC):
    """Arrays with a row per environment, which sensors read as a field of the robot state.

    Attributes:
        field: Name of the field of `RobotState`.
    """

    field: ClassVar[str]

    @abstractmethod
    def initial_arrays(self, robot_state: RobotState) -> dict[str, np.ndarray]:
        """The arrays at the start of episodes, by name, each of shape (num_envs, ...)."""

    @abstractmethod
    def update(self, robot_state: RobotState, commands: np.ndarray) -> None:
        """Add the latest robot state and the latest commands, shape (num_envs, 2)."""

    def reset(self, robot_state: RobotState) -> None:
        """Start an episode in every environment."""
        self._arrays = self.initial_arrays(robot_state)
        self.update(robot_state, robot_state.command)

    def reset_at(self, indices: np.ndarray, robot_state: RobotState) -> None:
        """Start episodes in the environments `indices` (n,); `robot_state` has n rows."""
        fresh = copy(self)
        fresh.reset(robot_state)
        for name, values in fresh._arrays.items():
            self._arrays[name][indices] = values

    def rows(self, indices: np.ndarray) -> Self:
        """A copy with the rows of the environments `indices` (n,) only."""
        selected = copy(self)
        selected._arrays = {name: values[indices] for name, values in self._arrays.items()}
        return selected

    def state(self) -> dict[str, Any]:
        """Copies of all arrays, by name."""
        return {name: values.copy() for name, values in self._arrays.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state`."""
        self._arrays = {name: np.array(values) for name, values in state.items()}


class CommandHistory(EpisodeState):
    """The latest commands, without which the decision process of a robot with latency is not Markovian.

    Args:
        length: Number of commands.
    """

    field = "command_history"

    def __init__(self, length: int) -> None:
        self._length = length

    def initial_arrays(self, robot_state: RobotState) -> dict[str, np.ndarray]:
        """The command at the start, repeated; it is not 0 if a robot gets a new goal while it drives."""
        return {"commands": robot_state.command[:, None].repeat(self._length, axis=1)}  # the newest first

    def update(self, robot_state: RobotState, commands: np.ndarray) -> None:
        self._arrays["commands"] = np.concatenate([commands[:, None], self._arrays["commands"][:, :-1]], axis=1)

    def last(self, count: int) -> np.ndarray:
        """Commands v [m/s] and w [rad/s], the newest first, shape (num_envs, count, 2)."""
        return self._arrays["commands"][:, :count]


class PositionHistory(EpisodeState):
    """Positions by odometry in the last minute, about one per second; they help a robot to leave a dead end.

    Args:
        period: Control period [s].
    """

    field = "position_history"

    def __init__(self, period: float) -> None:
        self._interval_steps = max(1, round(1.0 / period))  # [control steps] between two positions
        self._interval = self._interval_steps * period  # [s]
        self._num_positions = max(1, round(_HISTORY_DURATION / self._interval))

    def initial_arrays(self, robot_state: RobotState) -> dict[str, np.ndarray]:
        num_envs = len(robot_state.pose)
        return {"positions": np.full((num_envs, self._num_positions, 2), np.inf), "steps": np.zeros(num_envs, np.int64)}

    def update(self, robot_state: RobotState, commands: np.ndarray) -> None:
        steps = self._arrays["steps"]
        envs = np.flatnonzero(steps % self._interval_steps == 0)
        oldest = steps[envs] // self._interval_steps % self._num_positions  # indices of the positions to overwrite
        self._arrays["positions"][envs, oldest] = robot_state.odometry[envs, :2]
        steps += 1

    def seconds_near(self, points: np.ndarray, radius: float) -> np.ndarray:
        """Time [s] spent within `radius` [m] of points (num_envs, n, 2), shape (num_envs, n)."""
        counts = np.empty(points.shape[:2])
        _count_nearby(self._arrays["positions"], points, radius, counts)
        return self._interval * counts


@njit(cache=True, **NO_REFCOUNT)
def _count_nearby(positions, points, radius, counts):
    """Count the positions (num_envs, num_positions, 2) within `radius` of each point (num_envs, n, 2)."""
    for i in range(counts.shape[0]):
        for point in range(counts.shape[1]):
            x, y, count = points[i, point, 0], points[i, point, 1], 0
            for k in range(positions.shape[1]):
                dx, dy = positions[i, k, 0] - x, positions[i, k, 1] - y
                count += dx * dx + dy * dy < radius * radius
            counts[i, point] = count
