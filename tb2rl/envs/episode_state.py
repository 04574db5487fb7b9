"""Episode states: histories and maps that last for an episode, besides the latest robot state."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.simulation import RobotState, SimulationSpec
from tb2rl.simulation.spec import BOUNDS
from tb2rl.worlds.floor import CELL_SIZE
from tb2rl.worlds.goal_paths import PREFERRED_GAP, lookahead_points, path_costs, path_lengths_to

_HISTORY_DURATION = 64.0  # [s] time that `PositionHistory` covers
_PLANNING_PERIOD = 6  # [control steps] time between two plans of `OccupancyMapper`
_HIT_INCREMENT = 4  # added to the score of the cell where a beam ends; a passing beam subtracts 1
_MAX_HITS = 20  # largest score; the smallest is minus this


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


class OccupancyMapper(EpisodeState):
    """Online mapping: each robot builds an occupancy grid from its laser scans, and plans its path to the goal on it.

    Each cell has a score `hits`, which is above 0 if the cell is occupied (Moravec & Elfes 1985, "High resolution maps
    from wide angle sonar"). Unknown space is free, as with `allow_unknown` in Nav2, so the plan changes with new scans.
    The exact pose and the size of the floor are known, but no obstacles.

    Args:
        spec: The robot, its laser and the worlds, of which only the sizes are used.
    """

    field = "occupancy_map"

    def __init__(self, spec: SimulationSpec) -> None:
        bounds = spec.table[:, BOUNDS]
        self._shape = tuple(np.ceil((bounds[:, [3, 2]] - bounds[:, [1, 0]]).max(axis=0) / CELL_SIZE).astype(int) + 1)
        self._radius, self._angles, self._max_range = spec.robot.radius, spec.laser.angles, spec.laser.max_range

    def initial_arrays(self, robot_state: RobotState) -> dict[str, np.ndarray]:
        shape = len(robot_state.pose), *self._shape
        hits, path_length = np.zeros(shape, np.int8), np.empty(shape, np.float32)
        return {"hits": hits, "path_length": path_length, "age": np.full(shape[0], _PLANNING_PERIOD)}

    def update(self, robot_state: RobotState, commands: np.ndarray) -> None:
        """Add the latest scans to the grids, and renew the plans that are old enough."""
        geometries, arrays = self._grid_geometries(robot_state), self._arrays
        max_clearance = self._radius + PREFERRED_GAP
        poses, ranges = np.array(robot_state.pose), np.array(robot_state.ranges)
        _add_scans(poses, ranges, self._angles, self._max_range, geometries, arrays["hits"])
        arrays["age"] += 1
        for i in np.flatnonzero(arrays["age"] >= _PLANNING_PERIOD):
            clearance = np.minimum(self._distance_to_bounds(robot_state.initial_state.bounds[i]), max_clearance)
            _limit_clearance(arrays["hits"][i], max_clearance, clearance)
            costs = path_costs(clearance, self._radius)
            arrays["path_length"][i] = path_lengths_to(robot_state.goal[i], costs, geometries[i])
            arrays["age"][i] = 0

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        points, lengths = np.empty((len(robot_state.pose), 2)), self._arrays["path_length"]
        offsets = np.arange(len(lengths)) * math.prod(self._shape)  # first cell of each grid in the flat array
        poses, goals = np.array(robot_state.pose), np.array(robot_state.goal)  # contiguous for compiled code
        lookahead_points(offsets, self._grid_geometries(robot_state), lengths.ravel(), poses, goals, lookahead, points)
        return points

    def _distance_to_bounds(self, bounds: np.ndarray) -> np.ndarray:
        """Distance of each cell to the bounds (4,) [m], shape (rows, columns); 0 outside the bounds."""
        rows, columns = self._shape
        y, x = CELL_SIZE * np.arange(rows)[:, None], CELL_SIZE * np.arange(columns)
        gap_x, gap_y = np.minimum(x, bounds[2] - bounds[0] - x), np.minimum(y, bounds[3] - bounds[1] - y)
        return np.maximum(np.minimum(gap_x, gap_y), 0.0)

    def _grid_geometries(self, robot_state: RobotState) -> np.ndarray:
        """Geometry of each grid: rows, columns, x, y of the first cell's centre [m], cell size [m]; (num_envs, 5)."""
        corners = robot_state.initial_state.bounds[:, :2]
        ones = np.ones((len(corners), 1))
        return np.column_stack([self._shape * ones, corners, CELL_SIZE * ones])


@njit(cache=True)
def _add_scans(poses, ranges, angles, max_range, geometries, hits):
    """Increase `hits` (num_envs, rows, columns) where beams (num_envs, beams) end, and decrease it where they pass.

    A beam without a hit passes up to `max_range` [m].
    """
    rows, columns = hits.shape[1], hits.shape[2]
    for i in range(poses.shape[0]):
        x, y = (poses[i, 0] - geometries[i, 2]) / CELL_SIZE, (poses[i, 1] - geometries[i, 3]) / CELL_SIZE
        for beam in range(ranges.shape[1]):
            heading, length = poses[i, 2] + angles[beam], min(ranges[i, beam], max_range) / CELL_SIZE
            dx, dy = math.cos(heading), math.sin(heading)
            last_row, last_column = round(y + length * dy), round(x + length * dx)
            for step in range(int(2 * length)):
                row, column = round(y + 0.5 * step * dy), round(x + 0.5 * step * dx)
                if not (0 <= row < rows and 0 <= column < columns):
                    break
                if (row != last_row or column != last_column) and hits[i, row, column] > -_MAX_HITS:
                    hits[i, row, column] -= 1
            is_hit = 0 <= last_row < rows and 0 <= last_column < columns and ranges[i, beam] <= max_range
            if is_hit and hits[i, last_row, last_column] < _MAX_HITS:
                hits[i, last_row, last_column] = min(hits[i, last_row, last_column] + _HIT_INCREMENT, _MAX_HITS)


@njit(cache=True)
def _limit_clearance(hits, max_clearance, clearance):
    """Lower `clearance` (rows, columns) [m] to the distance from occupied cells, up to `max_clearance` [m]."""
    rows, columns = hits.shape
    max_cells = int(max_clearance / CELL_SIZE)
    for row in range(rows):
        for column in range(columns):
            if hits[row, column] <= 0:
                continue
            for r in range(max(row - max_cells, 0), min(row + max_cells + 1, rows)):
                for c in range(max(column - max_cells, 0), min(column + max_cells + 1, columns)):
                    clearance[r, c] = min(clearance[r, c], CELL_SIZE * math.hypot(r - row, c - column))
