"""Where robots can begin in any of many worlds, without Python for each robot.

`World.poses_from` is exact, and takes a second for the first poses in a world of hundreds of posts. Here places are
squares of a grid, see `tb2rl.worlds.floor`, each with the room that is around its middle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.worlds.floor import SIDE, Floor
from tb2rl.worlds.world import World


class Places:
    """The squares of many worlds in one table, each world's looked for when a robot first begins there.

    Args:
        worlds: Which.
        radius: Of the robot [m]; doors that it fits through are ways, even if no episode can begin in them.
    """

    def __init__(self, worlds: Sequence[World], radius: float) -> None:
        self._worlds, self._radius = worlds, radius
        self._tables: dict[float, _Table] = {}

    def poses_from(self, worlds: np.ndarray, draws: np.ndarray, clearance: float) -> np.ndarray:
        """The poses that four random numbers in [0, 1) each mean: a square, a point around its middle, a heading.

        They are where a robot gets to from the start of its world, spread evenly but for the last centimetres to walls.

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
        _place_in_squares(worlds, draws, table.first, table.count, table.squares, poses)
        return poses

    def _squares(self, world: World, clearance: float) -> np.ndarray:
        """x, y of the middle of each square where a robot can begin, and how far from it [m], shape (n, 3)."""
        floor = Floor.of(world, max(clearance, self._radius) + SIDE)
        steps = floor.steps_from(*world.start[:2], self._radius)
        row, column = np.nonzero((steps >= 0) & (floor.clearance >= clearance))
        if not len(row):  # in the middle of no square
            return np.array([(*world.start[:2], 0.0)], dtype=np.float32)
        room = (floor.clearance[row, column] - clearance) / math.sqrt(2.0)
        (left, bottom), room = floor.corner, np.minimum(room, SIDE / 2)
        return np.column_stack([left + SIDE * column, bottom + SIDE * row, room]).astype(np.float32)


class _Table:
    """The squares of all worlds, one world after the other as they were added."""

    def __init__(self, worlds: int) -> None:
        self.first, self.count = np.full(worlds, -1), np.zeros(worlds, dtype=int)
        self._used, self._room = 0, np.empty((0, 3), dtype=np.float32)

    @property
    def squares(self) -> np.ndarray:
        """Rows of x, y and how far from there [m], shape (squares, 3)."""
        return self._room[: self._used]

    def add(self, world: int, squares: np.ndarray) -> None:
        """Add those of a world; the table grows by half, so that it is seldom copied."""
        needed = self._used + len(squares)
        if needed > len(self._room):
            grown = np.empty((needed + needed // 2, 3), dtype=np.float32)
            grown[: self._used] = self.squares
            self._room = grown
        self._room[self._used : needed] = squares
        self.first[world], self.count[world], self._used = self._used, len(squares), needed


@njit(cache=True)
def _place_in_squares(worlds, draws, first, count, squares, poses):
    """Write the pose (num_envs, 3) that each robot's four numbers (num_envs, 4) mean; see `Places.poses_from`."""
    for i in range(draws.shape[0]):
        k = worlds[i]
        square = first[k] + min(int(draws[i, 0] * count[k]), count[k] - 1)
        for axis in range(2):
            poses[i, axis] = squares[square, axis] + (2.0 * draws[i, 1 + axis] - 1.0) * squares[square, 2]
        poses[i, 2] = math.tau * draws[i, 3] - math.pi
