"""Grid of the floor of a world: clearance and reachability of its cells, and random start poses in the free ones.

The computation takes milliseconds, while that of the exact free space (`World.free_space`) takes up to a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.core.errors import InputError
from tb2rl.worlds.geometry import distance_to_post, squared_distance_to_box
from tb2rl.worlds.spatial_index import bounding_boxes
from tb2rl.worlds.world import World

# [m] Side of a cell. If two adjacent centres keep 0.18 m from all walls, all points between them keep 0.17 m.
CELL_SIZE = 0.1
MAX_CELLS = 4_000_000  # limit of a grid, enough for a floor of 200 x 200 m, which takes 0.25 GB


@dataclass(frozen=True)
class Floor:
    """Grid of cells within the bounds of a world.

    Attributes:
        clearance: Distance from each cell centre to the nearest obstacle or bound, clipped [m], shape (rows, columns).
        first_centre: x and y of the centre of the lower left cell [m].
        cell_side: Side of a cell [m].
    """

    clearance: np.ndarray
    first_centre: tuple[float, float]
    cell_side: float

    @classmethod
    def of(cls, world: World, max_clearance: float, cell_side: float = CELL_SIZE) -> Floor:
        """Divide the floor of a world into cells, with clearances clipped at `max_clearance` [m].

        Raises:
            InputError: If the floor has more than `MAX_CELLS`.
        """
        x0, y0, x1, y1 = world.bounds
        if (x1 - x0) * (y1 - y0) > MAX_CELLS * cell_side**2:
            problem = f"{x1 - x0:.4g} x {y1 - y0:.4g} m have more than {MAX_CELLS} cells of {cell_side:g} m"
            raise InputError(f"world {world.name}: {problem}; set bounds")
        columns, rows = max(1, math.floor((x1 - x0) / cell_side)), max(1, math.floor((y1 - y0) / cell_side))
        left, bottom = (x0 + x1 - (columns - 1) * cell_side) / 2, (y0 + y1 - (rows - 1) * cell_side) / 2
        x, y = left + cell_side * np.arange(columns), bottom + cell_side * np.arange(rows)
        clearance = np.minimum(np.minimum(y - y0, y1 - y)[:, None], np.minimum(x - x0, x1 - x))
        clearance = np.minimum(clearance, max_clearance)
        limit_to_obstacles(world.boxes, world.posts, x, y, max_clearance, clearance)
        return cls(clearance, (left, bottom), cell_side)

    def steps_from(self, x: float, y: float, clearance: float) -> np.ndarray:
        """Number of steps from the cell at x, y [m] to each cell, through cells with at least this clearance [m].

        Returns:
            Shape (rows, columns): 0 in the first cell, whatever its clearance, and inf in unreachable cells.
        """
        steps = np.full(self.clearance.shape, np.inf)
        steps[self.cell_at(x, y)] = 0.0
        flood(steps, self.clearance >= clearance, 1.0)
        return steps

    def cell_at(self, x: float, y: float) -> tuple[int, int]:
        """Row and column of the cell nearest to a point [m]."""
        (rows, columns), (left, bottom), cell_side = self.clearance.shape, self.first_centre, self.cell_side
        return nearest_cell(y, bottom, cell_side, rows), nearest_cell(x, left, cell_side, columns)

    def centre(self, row: int, column: int) -> tuple[float, float]:
        """X and y of the centre of a cell [m]."""
        return self.first_centre[0] + self.cell_side * column, self.first_centre[1] + self.cell_side * row

    def centres(self, mask: np.ndarray) -> np.ndarray:
        """X and y of the centres of the cells in a mask (rows, columns) [m], shape (n, 2)."""
        return self.first_centre + self.cell_side * np.argwhere(mask)[:, ::-1]


def nearest_cell(coordinate: float, first_centre: float, cell_side: float, count: float) -> int:
    """Index, below `count`, of the row or column nearest to a coordinate [m]; 0 at `first_centre` [m], and for NaN."""
    return 0 if math.isnan(coordinate) else int(min(max(round((coordinate - first_centre) / cell_side), 0), count - 1))


class RaggedTable:
    """Arrays of different lengths, one after the other in a float32 table that grows in amortised constant time.

    Attributes:
        first_rows: First row of each array in the table, shape (count,); -1 before the array is added.
        lengths: Number of rows of each array, shape (count,).
    """

    def __init__(self, count: int, *row_shape: int) -> None:
        self.first_rows, self.lengths = np.full(count, -1), np.zeros(count, dtype=int)
        self._used, self._memory = 0, np.empty((0, *row_shape), dtype=np.float32)

    @property
    def rows(self) -> np.ndarray:
        """All rows, shape (rows, *row_shape)."""
        return self._memory[: self._used]

    def reserve(self, count: int) -> None:
        """Make room for so many rows at once, because each growth copies the table."""
        needed = self._used + count
        if needed > len(self._memory):
            larger = np.empty((needed + needed // 2, *self._memory.shape[1:]), dtype=np.float32)  # unused: not resident
            larger[: self._used] = self.rows
            self._memory = larger

    def add(self, index: int, rows: np.ndarray) -> None:
        """Add the array with this index, below `count`."""
        self.reserve(len(rows))
        first, self._used = self._used, self._used + len(rows)
        self._memory[first : self._used] = rows
        self.first_rows[index], self.lengths[index] = first, len(rows)


class PoseSampler:
    """Samples start poses of a robot with a radius [m] in many worlds, for all environments at once in compiled code.

    `World.sample_poses` samples the exact free space instead.

    A cell is reachable if the robot itself has room on a path to it; the path may have less than the clearance of the
    poses. The free cells of a world are computed when its first pose is sampled.
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


def limit_to_obstacles(
    boxes: np.ndarray, posts: np.ndarray, x: np.ndarray, y: np.ndarray, max_clearance: float, clearance: np.ndarray
) -> None:
    """Limit `clearance` (rows, columns), in place, to the distance from each obstacle within `max_clearance` [m].

    `x` (columns,) and `y` (rows,) are the cell centres [m], in ascending order.
    """
    centres, half_sizes = bounding_boxes(boxes, posts)
    low, high = centres - half_sizes - max_clearance, centres + half_sizes + max_clearance
    columns = np.column_stack([np.searchsorted(x, low[:, 0]), np.searchsorted(x, high[:, 0], side="right")])
    rows = np.column_stack([np.searchsorted(y, low[:, 1]), np.searchsorted(y, high[:, 1], side="right")])
    _limit_cells(boxes, posts, x, y, columns, rows, clearance)


@njit(cache=True, nogil=True)
def _limit_cells(boxes, posts, x, y, columns, rows, clearance):
    """Do `limit_to_obstacles` with the range of columns and of rows near each obstacle, each (obstacles, 2)."""
    for k in range(columns.shape[0]):
        for row in range(rows[k, 0], rows[k, 1]):
            for column in range(columns[k, 0], columns[k, 1]):
                if k < boxes.shape[0]:
                    distance = math.sqrt(squared_distance_to_box(x[column], y[row], boxes, k))
                else:
                    distance = distance_to_post(x[column], y[row], posts, k - boxes.shape[0])
                clearance[row, column] = min(clearance[row, column], distance)


@njit(cache=True, nogil=True)
def flood(values, passable, step):
    """Spread finite values to passable cells by breadth-first search, in place.

    Args:
        values: Values of the cells, inf in cells without a value, shape (rows, columns).
        passable: Mask of the cells that may get a value, shape (rows, columns).
        step: Increase of the value from a cell to the next cell.
    """
    rows, columns = values.shape
    queue, size, head = np.empty((values.size, 2), dtype=np.int64), 0, 0  # an array, because lists of tuples are slow
    for r in range(rows):
        for c in range(columns):
            if np.isfinite(values[r, c]):
                queue[size, 0], queue[size, 1] = r, c
                size += 1
    while head < size:
        row, column = queue[head, 0], queue[head, 1]
        head += 1
        for r, c in ((row, column + 1), (row + 1, column), (row, column - 1), (row - 1, column)):
            if 0 <= r < rows and 0 <= c < columns and passable[r, c] and values[r, c] == np.inf:
                values[r, c] = values[row, column] + step
                queue[size, 0], queue[size, 1] = r, c
                size += 1
