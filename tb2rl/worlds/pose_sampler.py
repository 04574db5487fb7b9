"""Random start poses in many worlds, sampled for all environments at once in compiled code.

`World.sample_poses` samples the exact free space, whose computation takes a second in a world of hundreds of posts.
This module samples the free cells of the grid of `tb2rl.worlds.floor` instead.
"""

import math
from collections.abc import Sequence

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.worlds.floor import CELL_SIZE, Floor, RaggedTable
from tb2rl.worlds.world import World


class PoseSampler:
    """Samples start poses of a robot with a radius [m] in many worlds.

    A cell is reachable through any door that is wider than the robot. The free cells of a world are computed when its
    first pose is sampled.
    """

    def __init__(self, worlds: Sequence[World], radius: float) -> None:
        self._worlds, self._radius = worlds, radius
        self._tables: dict[float, RaggedTable] = {}  # free cells of each world, by clearance

    def sample_poses(self, worlds: np.ndarray, random_numbers: np.ndarray, clearance: float) -> np.ndarray:
        """Sample poses that are reachable from the start of their world, uniformly except near walls.

        Args:
            worlds: Index of the world of each environment, shape (num_envs,).
            random_numbers: Uniform in [0, 1), for cell, offset in x, offset in y, and yaw; shape (num_envs, 4).
            clearance: Minimum distance to obstacles and bounds [m]; the start of each world must have it.

        Returns:
            x [m], y [m], yaw [rad], shape (num_envs, 3).
        """
        table = self._tables.setdefault(clearance, RaggedTable(len(self._worlds), 3))
        for world in np.unique(worlds[table.first_rows[worlds] < 0]).tolist():
            table.add(world, self._free_cells(self._worlds[world], clearance))
        poses = np.empty((len(random_numbers), 3))
        _sample_in_cells(worlds, random_numbers, table.first_rows, table.lengths, table.rows, poses)
        return poses

    def _free_cells(self, world: World, clearance: float) -> np.ndarray:
        """Centre x, y of each cell with room for a start, and largest offset of the start in x and in y [m], (n, 3)."""
        floor = Floor.of(world, max(clearance, self._radius) + CELL_SIZE)
        is_free = np.isfinite(floor.steps_from(*world.start[:2], self._radius)) & (floor.clearance >= clearance)
        if not is_free.any():  # the start of the world has the clearance, but no centre of a cell has it
            return np.array([(*world.start[:2], 0.0)])
        max_offset = (floor.clearance[is_free] - clearance) / math.sqrt(2.0)
        return np.column_stack([floor.centres(is_free), np.minimum(max_offset, CELL_SIZE / 2)])


@njit(cache=True)
def _sample_in_cells(worlds, random_numbers, first_cells, cell_counts, cells, poses):
    """Write random `poses` (num_envs, 3) in the `cells` of all worlds, whose rows are those of `_free_cells`.

    `first_cells` and `cell_counts` (worlds,) are the first row of each world and its number of rows.
    """
    for i in range(random_numbers.shape[0]):
        world = worlds[i]
        cell = first_cells[world] + min(int(random_numbers[i, 0] * cell_counts[world]), cell_counts[world] - 1)
        for axis in range(2):
            poses[i, axis] = cells[cell, axis] + (2.0 * random_numbers[i, 1 + axis] - 1.0) * cells[cell, 2]
        poses[i, 2] = math.tau * random_numbers[i, 3] - math.pi
