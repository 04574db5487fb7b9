"""Episode states: histories, and the base class of maps, that last for an episode, besides the latest robot state."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.core.threads import parallel_if_long
from tb2rl.simulation import RobotState

_HISTORY_DURATION = 64.0  # [s] time that `PositionHistory` covers
_POINT_TIME = 0.2e-9  # [s] estimated duration of the comparison of a position with a point
_ROUNDING = 1e-3  # [m] more than all rounding errors of a distance


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

    def seconds_near(self, poses: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
        """See `tb2rl.simulation.robot_state.PositionHistory`."""
        seconds = np.empty((len(poses), len(points)))
        history = self._arrays["positions"], self._arrays["steps"], self._interval_steps, self._interval
        x, y, yaw = poses.T
        frames = np.stack([x, y, np.cos(yaw), np.sin(yaw)])
        item_time = _POINT_TIME * self._num_positions * len(points)
        parallel_if_long(_sum_nearby, len(poses), item_time, history, frames, points.T.copy(), radius, seconds)
        return seconds


@njit(cache=True, nogil=True)
def _sum_nearby(first, end, history, frames, points, radius, seconds):
    """Write the `seconds` (num_envs, n) that robots have spent near points, for the robots `first` to `end` - 1.

    Args:
        history: Positions (num_envs, num_positions, 2) [m], numbers of steps (num_envs,), and the interval between two
            positions in control steps and in [s].
        frames: x, y [m], cosine and sine of the yaw of each robot, shape (4, num_envs).
        points: x and y in the robot's frame [m], shape (2, n).
        radius: Largest distance from a point [m].
    """
    scratch = np.empty(points.shape)
    for i in range(first, end):
        _sum_nearby_one(i, history, frames, points, radius, scratch, seconds)


@njit(cache=True, **NO_REFCOUNT)
def _sum_nearby_one(i, history, frames, points, radius, scratch, seconds):
    """Do `_sum_nearby` for robot `i`; `scratch` has the shape of `points`."""
    positions, steps, interval_steps, interval = history
    robot_x, robot_y, cos, sin = frames[0, i], frames[1, i], frames[2, i], frames[3, i]
    reach = 0.0
    for point in range(points.shape[1]):
        ahead, left = points[0, point], points[1, point]
        scratch[0, point] = robot_x + cos * ahead - sin * left
        scratch[1, point] = robot_y + sin * ahead + cos * left
        seconds[i, point] = 0.0
        reach = max(reach, ahead * ahead + left * left)
    reach = math.sqrt(reach) + radius + _ROUNDING
    for k in range(min((steps[i] + interval_steps - 1) // interval_steps, positions.shape[1])):
        x, y = positions[i, k, 0], positions[i, k, 1]
        if (x - robot_x) * (x - robot_x) + (y - robot_y) * (y - robot_y) > reach * reach:
            continue  # near no point
        for point in range(points.shape[1]):  # the inner loop, because its data is contiguous
            dx, dy = x - scratch[0, point], y - scratch[1, point]
            seconds[i, point] += 1.0 if dx * dx + dy * dy < radius * radius else 0.0
    for point in range(points.shape[1]):
        seconds[i, point] *= interval
