"""The floor of a world as a grid of squares: how far each is from what stands there, and which a robot can get to.

A grid takes milliseconds where the exact free space (`World.free_space`) takes a second: thousands of worlds need it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tb2rl.core.compiled import njit
from tb2rl.core.errors import InputError
from tb2rl.worlds.world import World

SIDE = 0.1  # [m] of a square; so two that touch, each 0.18 m from all walls, have 0.17 m between them

MOST_SQUARES = 4_000_000  # 200 x 200 m: a quarter of a gigabyte


@dataclass(frozen=True)
class Floor:
    """The squares between the bounds of a world.

    Attributes:
        clearance: From the middle of each to the nearest obstacle and to the bounds, at most what was asked [m], shape
            (rows, columns).
        corner: x and y of the lower left one's middle [m].
        side: Of a square [m].
    """

    clearance: np.ndarray
    corner: tuple[float, float]
    side: float = SIDE

    @classmethod
    def of(cls, world: World, reach: float, side: float = SIDE) -> Floor:
        """The floor of a world in squares of that side [m], with clearances up to `reach` [m].

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
        clearance = np.minimum(clearance, reach)
        _lower_around(left, bottom, side, world.boxes, world.posts, reach, clearance)
        return cls(clearance, (left, bottom), side)

    def steps_from(self, x: float, y: float, clearance: float) -> np.ndarray:
        """Squares on the way to each from the one at x, y [m], over those with that clearance [m]; -1: there is none.

        Returns:
            Shape (rows, columns), int32; 0 at the start itself, which counts as free.
        """
        rows, columns = self.clearance.shape
        column = min(max(round((x - self.corner[0]) / self.side), 0), columns - 1)
        row = min(max(round((y - self.corner[1]) / self.side), 0), rows - 1)
        steps = np.full((rows, columns), -1, dtype=np.int32)
        _flood(self.clearance >= clearance, row, column, steps)
        return steps

    def middle(self, row: int, column: int) -> tuple[float, float]:
        """X and y of the middle of a square [m]."""
        return self.corner[0] + self.side * column, self.corner[1] + self.side * row


@njit(cache=True)
def _lower_around(left, bottom, side, boxes, posts, reach, grid):
    """Lower `grid` (rows, columns) to the distance from each obstacle [m], in the squares that are `reach` from it."""
    for k in range(boxes.shape[0]):
        cos, sin = boxes[k, 4], boxes[k, 5]
        wide = boxes[k, 2] * abs(cos) + boxes[k, 3] * abs(sin) + reach
        high = boxes[k, 2] * abs(sin) + boxes[k, 3] * abs(cos) + reach
        for row in range(*_within(boxes[k, 1] - bottom, high, side, grid.shape[0])):
            for column in range(*_within(boxes[k, 0] - left, wide, side, grid.shape[1])):
                east, north = left + side * column - boxes[k, 0], bottom + side * row - boxes[k, 1]
                dx = max(abs(cos * east + sin * north) - boxes[k, 2], 0.0)
                dy = max(abs(cos * north - sin * east) - boxes[k, 3], 0.0)
                grid[row, column] = min(grid[row, column], math.sqrt(dx * dx + dy * dy))
    for k in range(posts.shape[0]):
        wide = posts[k, 2] + reach
        for row in range(*_within(posts[k, 1] - bottom, wide, side, grid.shape[0])):
            for column in range(*_within(posts[k, 0] - left, wide, side, grid.shape[1])):
                east, north = left + side * column - posts[k, 0], bottom + side * row - posts[k, 1]
                grid[row, column] = min(
                    grid[row, column], max(math.sqrt(east * east + north * north) - posts[k, 2], 0.0)
                )


@njit(cache=True)
def _within(middle, half, side, count):
    """The first and the last but one of `count` squares whose middles are within `half` of `middle` [m]."""
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
