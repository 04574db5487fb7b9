"""Online mapping: each robot makes an occupancy grid from its laser, and plans its path on it.

The grid counts hits (Moravec & Elfes 1985, "High resolution maps from wide angle sonar"). Unknown space counts as free,
as with `allow_unknown` in ROS's navigation, so the plan changes as the robot sees more. The robot knows its pose, as
from a good localisation, and the size of the floor, but no obstacles beforehand.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.envs.episode_state import EpisodeState
from tb2rl.simulation import RobotState, SimulationSpec
from tb2rl.simulation.spec import BOUNDS
from tb2rl.worlds.floor import SIDE
from tb2rl.worlds.goal_paths import KEEP_OFF, march_from, points_ahead

_PLAN_EVERY = 6  # control steps
_HIT, _LIMIT = 4, 20  # added to a cell where a beam ends; a beam that passes subtracts 1; the limit of counts


class OccupancyMapper(EpisodeState):
    """Occupancy grids of all environments, and the paths to the goals on them.

    Args:
        spec: The robot, its laser and the worlds; only their sizes are used.
    """

    field = "occupancy_map"

    def __init__(self, spec: SimulationSpec) -> None:
        super().__init__()
        bounds = spec.table[:, BOUNDS]
        self._size = tuple(np.ceil((bounds[:, [3, 2]] - bounds[:, [1, 0]]).max(axis=0) / SIDE).astype(int) + 1)
        self._radius, self._angles, self._max_range = spec.robot.radius, spec.laser.angles, spec.laser.max_range

    def blank(self, num_envs: int) -> dict[str, np.ndarray]:
        return {
            "hits": np.zeros((num_envs, *self._size), np.int8),
            "path_length": np.empty((num_envs, *self._size), np.float32),
            "age": np.full(num_envs, _PLAN_EVERY),
        }

    def update(self, robot_state: RobotState) -> None:
        """Enter the present scans; plan again where a plan is due."""
        grids, rows, reach = self._grids(robot_state), self._rows, self._radius + KEEP_OFF
        _enter_scans(
            np.array(robot_state.pose), np.array(robot_state.ranges), self._angles, self._max_range, grids, rows["hits"]
        )
        rows["age"] += 1
        for i in np.flatnonzero(rows["age"] >= _PLAN_EVERY):
            clearance = np.minimum(self._inside(robot_state.initial_state.bounds[i]), reach)
            _limit_clearance(rows["hits"][i], reach, clearance)
            rows["path_length"][i] = march_from(clearance, self._radius, robot_state.goal[i], grids[i])
            rows["age"][i] = 0

    def lookahead_point(self, robot_state: RobotState, lookahead: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        points, lengths = np.empty((len(robot_state.pose), 2)), self._rows["path_length"]
        begins = np.arange(len(lengths)) * math.prod(self._size)
        poses, goals = np.array(robot_state.pose), np.array(robot_state.goal)  # contiguous, so it is compiled once
        points_ahead(begins, self._grids(robot_state), lengths.ravel(), poses, goals, lookahead, points)
        return points

    def _inside(self, bounds: np.ndarray) -> np.ndarray:
        """Distance of each cell from the bounds (4,) [m], 0 outside them; shape (rows, columns)."""
        rows, columns = self._size
        y, x = SIDE * np.arange(rows)[:, None], SIDE * np.arange(columns)
        across, along = np.minimum(x, bounds[2] - bounds[0] - x), np.minimum(y, bounds[3] - bounds[1] - y)
        return np.maximum(np.minimum(across, along), 0.0)

    def _grids(self, robot_state: RobotState) -> np.ndarray:
        """Rows, columns, x and y of the first cell's centre [m], side of a cell [m]; shape (num_envs, 5)."""
        corners = robot_state.initial_state.bounds[:, :2]
        ones = np.ones((len(corners), 1))
        return np.column_stack([self._size * ones, corners, SIDE * ones])


@njit(cache=True)
def _enter_scans(poses, ranges, angles, max_range, grids, hits):
    """Count `hits` (num_envs, rows, columns) up where beams (num_envs, beams) end, and down where they pass.

    A beam that hits nothing passes up to `max_range` [m].
    """
    rows, columns = hits.shape[1], hits.shape[2]
    for i in range(poses.shape[0]):
        x, y = (poses[i, 0] - grids[i, 2]) / SIDE, (poses[i, 1] - grids[i, 3]) / SIDE
        for beam in range(ranges.shape[1]):
            heading, length = poses[i, 2] + angles[beam], min(ranges[i, beam], max_range) / SIDE
            dx, dy = math.cos(heading), math.sin(heading)
            last_row, last_column = round(y + length * dy), round(x + length * dx)
            for step in range(int(2 * length)):
                row, column = round(y + 0.5 * step * dy), round(x + 0.5 * step * dx)
                if not (0 <= row < rows and 0 <= column < columns):
                    break
                if (row != last_row or column != last_column) and hits[i, row, column] > -_LIMIT:
                    hits[i, row, column] -= 1
            seen = 0 <= last_row < rows and 0 <= last_column < columns and ranges[i, beam] <= max_range
            if seen and hits[i, last_row, last_column] < _LIMIT:
                hits[i, last_row, last_column] = min(hits[i, last_row, last_column] + _HIT, _LIMIT)


@njit(cache=True)
def _limit_clearance(hits, reach, clearance):
    """Lower `clearance` (rows, columns) [m] to the distance from occupied cells of `hits`, up to `reach` [m]."""
    rows, columns = hits.shape
    cells = int(reach / SIDE)
    for row in range(rows):
        for column in range(columns):
            if hits[row, column] <= 0:
                continue
            for r in range(max(row - cells, 0), min(row + cells + 1, rows)):
                for c in range(max(column - cells, 0), min(column + cells + 1, columns)):
                    clearance[r, c] = min(clearance[r, c], SIDE * math.hypot(r - row, c - column))
