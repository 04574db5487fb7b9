"""The floor of a world as a grid of squares: their clearance, and which of them a robot can reach.

The grid takes milliseconds where the exact free space (`World.free_space`) takes a second; thousands of worlds need it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.core.errors import InputError
from tb2rl.worlds.grid import gap_to_post, squared_gap_to_box
from tb2rl.worlds.world import World

SIDE = 0.1  # [m] of a square; so between two neighbours, each 0.18 m from all walls, 0.17 m are free
MOST_SQUARES = 4_000_000  # 200 x 200 m: a quarter of a gigabyte


@dataclass(frozen=True)
class Floor:
    """The squares within the bounds of a world.

    Attributes:
        clearance: Distance from each centre to the nearest obstacle or bound, clipped [m], shape (rows, columns).
        corner: x and y of the lower left square's centre [m].
        side: Side of a square [m].
    """

    clearance: np.ndarray
    corner: tuple[float, float]
    side: float = SIDE

    @classmethod
    def of(cls, world: World, most: float, side: float = SIDE) -> Floor:
        """Divide the floor of a world into squares, with clearances clipped to `most` [m].

        Raises:
            InputError: If it has more than `MOST_SQUARES`.
        """
        x0, y0, x1, y1 = world.bounds
        if (x1 - x0) * (y1 - y0) > MOST_SQUARES * side**2:
            size = f"{x1 - x0:.4g} x {y1 - y0:.4g} m"
            raise InputError(
                f"world {world.name}: {size} have more than {MOST_SQUARES} squares of {side:g} m; set bounds"
            )
        columns, rows = max(1, math.floor((x1 - x0) / side)), max(1, math.floor((y1 - y0) / side))
        left, bottom = (x0 + x1 - (columns - 1) * side) / 2, (y0 + y1 - (rows - 1) * side) / 2
        x, y = left + side * np.arange(columns), bottom + side * np.arange(rows)
        clearance = np.minimum(np.minimum(y - y0, y1 - y)[:, None], np.minimum(x - x0, x1 - x))
        clearance = np.minimum(clearance, most)
        _lower_around(x, y, side, world.boxes, world.posts, most, clearance)
        return cls(clearance, (left, bottom), side)

    def steps_from(self, x: float, y: float, clearance: float) -> np.ndarray:
        """Count the steps from the square at x, y [m] over squares of that clearance [m]; -1 for unreachable squares.

        Returns:
            Shape (rows, columns), int32; 0 at the start itself, which counts as free.
        """
        steps = np.full(self.clearance.shape, -1, dtype=np.int32)
        _flood(self.clearance >= clearance, *self.square_at(x, y), steps)
        return steps

    def square_at(self, x: float, y: float) -> tuple[int, int]:
        """Row and column of the square at a point [m], or of the nearest one; 0 for NaN."""
        rows, columns = self.clearance.shape
        return nearest_square(y, self.corner[1], self.side, rows), nearest_square(x, self.corner[0], self.side, columns)

    def centre(self, row: int, column: int) -> tuple[float, float]:
        """X and y of a square's centre [m]."""
        return self.corner[0] + self.side * column, self.corner[1] + self.side * row

    def centres(self, selected: np.ndarray) -> np.ndarray:
        """X and y of the centres [m] of the squares that a mask (rows, columns) selects, shape (n, 2)."""
        row, column = np.nonzero(selected)
        return np.column_stack([self.corner[0] + self.side * column, self.corner[1] + self.side * row])


def nearest_square(at: float, first: float, side: float, count: float) -> int:
    """Row or column, of `count` whose first centre is at `first` [m], nearest to a coordinate [m]; 0 for NaN."""
    return 0 if math.isnan(at) else int(min(max(round((at - first) / side), 0), count - 1))


class GrowingTable:
    """Rows of float32 that can be appended; the memory grows by half, so that rows are seldom copied.

    Args:
        shape: Shape of one row.
    """

    def __init__(self, *shape: int) -> None:
        self._used, self._memory = 0, np.empty((0, *shape), dtype=np.float32)

    @property
    def rows(self) -> np.ndarray:
        """All rows, shape (rows, *shape)."""
        return self._memory[: self._used]

    def append(self, rows: np.ndarray) -> int:
        """Append rows; return the number of the first one."""
        first, needed = self._used, self._used + len(rows)
        if needed > len(self._memory):
            grown = np.empty((needed + needed // 2, *rows.shape[1:]), dtype=np.float32)
            grown[:first] = self.rows
            self._memory = grown
        self._memory[first:needed] = rows
        self._used = needed
        return first


@njit(cache=True)
def _lower_around(x, y, side, boxes, posts, most, grid):
    """Lower `grid` (rows, columns) to the distance from each obstacle [m], in the squares within `most` of it.

    `x` (columns,) and `y` (rows,) are the centres of the squares [m].
    """
    for k in range(boxes.shape[0]):
        cos, sin = boxes[k, 4], boxes[k, 5]
        wide = boxes[k, 2] * abs(cos) + boxes[k, 3] * abs(sin) + most
        high = boxes[k, 2] * abs(sin) + boxes[k, 3] * abs(cos) + most
        for row in range(*_within(boxes[k, 1] - y[0], high, side, y.size)):
            for column in range(*_within(boxes[k, 0] - x[0], wide, side, x.size)):
                gap = math.sqrt(squared_gap_to_box(x[column], y[row], boxes, k))
                grid[row, column] = min(grid[row, column], gap)
    for k in range(posts.shape[0]):
        wide = posts[k, 2] + most
        for row in range(*_within(posts[k, 1] - y[0], wide, side, y.size)):
            for column in range(*_within(posts[k, 0] - x[0], wide, side, x.size)):
                grid[row, column] = min(grid[row, column], gap_to_post(x[column], y[row], posts, k))


@njit(cache=True)
def _within(middle, half, side, count):
    """First and end of the squares, of `count`, whose centres are within `half` of `middle` [m]."""
    return max(math.ceil((middle - half) / side), 0), min(math.floor((middle + half) / side) + 1, count)


@njit(cache=True)
def _flood(free, row, column, steps):
    """Breadth-first search over the `free` squares (rows, columns) that share a side; see `Floor.steps_from`."""
    rows, columns = free.shape
    queue = np.empty(rows * columns, dtype=np.int64)
    queue[0], steps[row, column], first, last = row * columns + column, 0, 0, 1
    while first < last:
        i, j = queue[first] // columns, queue[first] % columns
        first += 1
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = i + down, j + right
            if 0 <= r < rows and 0 <= c < columns and free[r, c] and steps[r, c] < 0:
                steps[r, c] = steps[i, j] + 1
                queue[last] = r * columns + c
                last += 1
