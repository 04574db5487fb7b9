"""Planning on what was seen: each robot draws a map of what its laser sees, and plans its way on it.

The map is an occupancy grid (Moravec & Elfes 1985, "High resolution maps from wide angle sonar") that counts hits. What
was not seen counts as free, as ROS's navigation can be told (`allow_unknown`): so the plan changes as the robot sees
more. The robot knows where it is, as from a good localisation, and how large the floor is; of what stands on it, it
knows nothing beforehand.
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

_EVERY = 6  # control steps from one plan to the next
_HIT, _SURE = 4, 20  # what a beam that ends in a square adds, where one that passes takes 1; at most, both ways


class OccupancyMapper(EpisodeState):
    """Maps of what some robots have seen, and their ways to the goal on them.

    Args:
        spec: The robot, its laser and the worlds, of which only the size is used.
    """

    field = "occupancy_map"

    def __init__(self, spec: SimulationSpec) -> None:
        super().__init__()
        bounds = spec.table[:, BOUNDS]
        self._size = tuple(np.ceil((bounds[:, [3, 2]] - bounds[:, [1, 0]]).max(axis=0) / SIDE).astype(int) + 1)
        self._radius, self._angles, self._most = spec.robot.radius, spec.laser.angles, spec.laser.max_range

    def blank(self, num_envs: int) -> dict[str, np.ndarray]:
        return {
            "hits": np.zeros((num_envs, *self._size), np.int8),
            "way": np.empty((num_envs, *self._size), np.float32),
            "age": np.full(num_envs, _EVERY),
        }

    def update(self, robot_state: RobotState) -> None:
        """Note what all robots see now; plan anew where it is time to."""
        grids, rows, reach = self._grids(robot_state), self._rows, self._radius + KEEP_OFF
        _note(np.array(robot_state.pose), np.array(robot_state.ranges), self._angles, self._most, grids, rows["hits"])
        rows["age"] += 1
        for i in np.flatnonzero(rows["age"] >= _EVERY):
            clearance = np.minimum(self._inside(robot_state.initial_state.bounds[i]), reach)
            _keep_off(rows["hits"][i], reach, clearance)
            rows["way"][i] = march_from(clearance, self._radius, robot_state.goal[i], grids[i])
            rows["age"][i] = 0

    def lookahead_point(self, robot_state: RobotState, reach: float) -> np.ndarray:
        """See `RobotState.lookahead_point`."""
        points, ways = np.empty((len(robot_state.pose), 2)), self._rows["way"]
        begins = np.arange(len(ways)) * math.prod(self._size)
        place, goal = np.array(robot_state.pose), np.array(robot_state.goal)  # compiled once, for arrays of one kind
        points_ahead(begins, self._grids(robot_state), ways.ravel(), place, goal, reach, points)
        return points

    def _inside(self, bounds: np.ndarray) -> np.ndarray:
        """How far the squares of a robot's map are within its bounds (4,) [m], 0 outside; shape (rows, columns)."""
        rows, columns = self._size
        y, x = SIDE * np.arange(rows)[:, None], SIDE * np.arange(columns)
        across, along = np.minimum(x, bounds[2] - bounds[0] - x), np.minimum(y, bounds[3] - bounds[1] - y)
        return np.maximum(np.minimum(across, along), 0.0)

    def _grids(self, robot_state: RobotState) -> np.ndarray:
        """Rows, columns, x and y of the first square's middle, side of a square [m] of each robot's map."""
        corners = robot_state.initial_state.bounds[:, :2]
        ones = np.ones((len(corners), 1))
        return np.column_stack([self._size * ones, corners, SIDE * ones])


@njit(cache=True)
def _note(poses, ranges, angles, most, grids, hits):
    """Count in `hits` (num_envs, rows, columns) up where beams (num_envs, beams) end, and down where they pass.

    Args:
        most: How far the laser sees [m]: so far a beam passes that hits nothing.
    """
    rows, columns = hits.shape[1], hits.shape[2]
    for i in range(poses.shape[0]):
        x, y = (poses[i, 0] - grids[i, 2]) / SIDE, (poses[i, 1] - grids[i, 3]) / SIDE
        for beam in range(ranges.shape[1]):
            heading, way = poses[i, 2] + angles[beam], min(ranges[i, beam], most) / SIDE
            dx, dy = math.cos(heading), math.sin(heading)
            last_row, last_column = round(y + way * dy), round(x + way * dx)
            for step in range(int(2 * way)):
                row, column = round(y + 0.5 * step * dy), round(x + 0.5 * step * dx)
                if not (0 <= row < rows and 0 <= column < columns):
                    break
                if (row != last_row or column != last_column) and hits[i, row, column] > -_SURE:
                    hits[i, row, column] -= 1
            seen = 0 <= last_row < rows and 0 <= last_column < columns and ranges[i, beam] <= most
            if seen and hits[i, last_row, last_column] < _SURE:
                hits[i, last_row, last_column] = min(hits[i, last_row, last_column] + _HIT, _SURE)


@njit(cache=True)
def _keep_off(hits, most, clearance):
    """Lower `clearance` (rows, columns) [m] to how far the squares are from those with something on them, up to `most`.

    Args:
        hits: See `_note`, shape (rows, columns).
        most: What is farther does not matter [m].
        clearance: Changed in place.
    """
    rows, columns = hits.shape
    reach = int(most / SIDE)
    for row in range(rows):
        for column in range(columns):
            if hits[row, column] <= 0:
                continue
            for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for c in range(max(column - reach, 0), min(column + reach + 1, columns)):
                    clearance[r, c] = min(clearance[r, c], SIDE * math.hypot(r - row, c - column))
