"""Start poses in any of many worlds, drawn without Python code per robot.

`World.poses_from` is exact, but its first poses take a second in a world of hundreds of posts. Here poses are drawn
from squares of `tb2rl.worlds.floor`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.worlds.floor import SIDE, Floor, GrowingTable
from tb2rl.worlds.world import World


class Places:
    """The squares of many worlds in one table; those of a world are found when a robot first starts there.

    Args:
        worlds: The worlds.
        radius: Radius of the robot [m]; it may pass doors that fit it, even if no episode can start in them.
    """

    def __init__(self, worlds: Sequence[World], radius: float) -> None:
        self._worlds, self._radius = worlds, radius
        self._tables: dict[float, _Table] = {}

    def poses_from(self, worlds: np.ndarray, draws: np.ndarray, clearance: float) -> np.ndarray:
        """Turn four random numbers in [0, 1) each into a pose: a square, a point around its centre, a heading.

        The poses can be reached from the start of their world, and are spread evenly except near walls.

        Args:
            worlds: Index of each robot's world, shape (num_envs,).
            draws: Shape (num_envs, 4).
            clearance: To obstacles and bounds [m]; the starts of the worlds have it.

        Returns:
            x [m], y [m], yaw [rad], shape (num_envs, 3).
        """
        table = self._tables.setdefault(clearance, _Table(len(self._worlds)))
        for world in np.unique(worlds[table.first[worlds] < 0]).tolist():
            table.add(world, self._squares(self._worlds[world], clearance))
        poses = np.empty((len(draws), 3))
        _place_in_squares(worlds, draws, table.first, table.count, table.squares.rows, poses)
        return poses

    def _squares(self, world: World, clearance: float) -> np.ndarray:
        """x, y of the centre of each possible square, and the largest offset from it [m], shape (n, 3)."""
        floor = Floor.of(world, max(clearance, self._radius) + SIDE)
        steps = floor.steps_from(*world.start[:2], self._radius)
        possible = (steps >= 0) & (floor.clearance >= clearance)
        if not possible.any():  # the start itself has room, but no centre of a square
            return np.array([(*world.start[:2], 0.0)], dtype=np.float32)
        room = (floor.clearance[possible] - clearance) / math.sqrt(2.0)
        return np.column_stack([floor.centres(possible), np.minimum(room, SIDE / 2)]).astype(np.float32)


class _Table:
    """Squares of all worlds: x, y and largest offset [m]; first row and number of rows of each world."""

    def __init__(self, worlds: int) -> None:
        self.first, self.count = np.full(worlds, -1), np.zeros(worlds, dtype=int)
        self.squares = GrowingTable(3)

    def add(self, world: int, squares: np.ndarray) -> None:
        self.first[world], self.count[world] = self.squares.append(squares), len(squares)


@njit(cache=True)
def _place_in_squares(worlds, draws, first, count, squares, poses):
    """Write the poses (num_envs, 3); see `Places.poses_from`."""
    for i in range(draws.shape[0]):
        k = worlds[i]
        square = first[k] + min(int(draws[i, 0] * count[k]), count[k] - 1)
        for axis in range(2):
            poses[i, axis] = squares[square, axis] + (2.0 * draws[i, 1 + axis] - 1.0) * squares[square, 2]
        poses[i, 2] = math.tau * draws[i, 3] - math.pi
