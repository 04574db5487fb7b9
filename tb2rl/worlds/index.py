"""Spatial index: in a world of many obstacles, a grid of square cells lists the obstacles in each cell.

Worlds of few obstacles have no grid, because plain loops over all beams are faster there. The obstacles of all worlds
stand in one table per kind, world after world, for the compiled code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tb2rl.core.compiled import njit

GRID_ABOVE = 100  # obstacles; up to here the plain loops are faster, with 36 beams
_ENTRIES = 32  # per obstacle, at most: obstacles that cover many cells, or each other, get larger cells
_SMALLEST = 1e-6  # [m] side of a cell
_SLACK = 1e-6  # of a cell's side, by which obstacles are enlarged; rounding errors are far smaller
# The columns of `WorldIndex.parts`.
X, Y, SIDE, COLUMNS, ROWS, CELLS, BOXES, BOXES_END, POSTS, POSTS_END = range(10)


class WorldIndex(NamedTuple):
    """Obstacles of one or more worlds, and their grids.

    Attributes:
        boxes, posts: Rows as in `World`, world after world.
        parts: One row per world, shape (worlds, 10): x, y of the grid's lower left corner and side of a cell [m],
            columns, rows (0 without a grid), offset of its cells in `lists`, first and end row of its boxes and posts.
        lists: For each world, per cell (row by row from below) the offset of its obstacles in this array, then the end
            of the last cell's; then the obstacles: k for row k of `boxes`, -1 - k for row k of `posts`.
    """

    boxes: np.ndarray
    posts: np.ndarray
    parts: np.ndarray
    lists: np.ndarray


def index_of(boxes: np.ndarray, posts: np.ndarray, grid_above: int = GRID_ABOVE) -> WorldIndex:
    """Index one world of `boxes` (n, 6) and `posts` (n, 3), with a grid if it has more than `grid_above` obstacles."""
    grid, lists = np.zeros(5), np.empty(0, dtype=np.int32)
    if len(boxes) + len(posts) > grid_above:
        grid, lists = _make_grid(boxes, posts)
    return WorldIndex(boxes, posts, np.array([[*grid, 0, 0, len(boxes), 0, len(posts)]]), lists)


def join(indices: Sequence[WorldIndex]) -> WorldIndex:
    """Concatenate the indices of single worlds."""
    if len(indices) == 1:
        return indices[0]
    parts = np.concatenate([index.parts for index in indices])
    for begin, end in ((BOXES, BOXES_END), (POSTS, POSTS_END)):
        parts[:, end] = np.cumsum(parts[:, end])
        parts[1:, begin] = parts[:-1, end]
    parts[1:, CELLS] = np.cumsum([len(index.lists) for index in indices])[:-1]
    lists = [index.lists.copy() for index in indices]
    for part, own in zip(parts.astype(np.int32), lists, strict=True):
        borders = part[COLUMNS] * part[ROWS] + 1
        own[:borders] += part[CELLS]
        entries = own[borders:]
        entries += np.where(entries < 0, -part[POSTS], part[BOXES])
    boxes, posts = (np.concatenate([index[table] for index in indices]) for table in (0, 1))
    return WorldIndex(boxes, posts, parts, np.concatenate(lists))


def _make_grid(boxes: np.ndarray, posts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make the first five columns of `WorldIndex.parts`, and `lists`."""
    count = len(boxes) + len(posts)
    half_length, half_width, cos, sin = boxes[:, 2:].T
    x_extent, y_extent = half_length * abs(cos) + half_width * abs(sin), half_length * abs(sin) + half_width * abs(cos)
    extents = np.concatenate([np.column_stack([x_extent, y_extent]), posts[:, [2, 2]]])
    centres = np.concatenate([boxes[:, :2], posts[:, :2]])
    low, high = (centres - extents).min(axis=0), (centres + extents).max(axis=0)
    size = high - low
    # About as many cells as obstacles: more make a ray visit more cells, fewer make each list longer.
    side = max(math.sqrt(size[0] * size[1] / count), size.max() / count, _SMALLEST)
    while True:
        corner = low - 2 * _SLACK * side
        columns, rows = np.floor(size / side + 1.001)  # the grid ends beyond the last obstacle
        grid = np.array([*corner, side, columns, rows])
        lists = _list_obstacles(boxes, posts, extents, grid, _ENTRIES * count)
        if len(lists):
            return grid, lists
        side *= 2.0


@njit(cache=True)
def _list_obstacles(boxes, posts, extents, grid, most):
    """Make `WorldIndex.lists`; return an empty array if that takes more than `most` entries.

    `extents` (obstacles, 2) are half sizes along x and y [m], boxes before posts.
    """
    x0, y0, side, columns, rows = grid[X], grid[Y], grid[SIDE], int(grid[COLUMNS]), int(grid[ROWS])
    half = (0.5 + _SLACK) * side
    counts = np.zeros(columns * rows + 1, dtype=np.int32)
    lists = ends = counts
    for filling in (False, True):
        for k in range(extents.shape[0]):
            post = k - boxes.shape[0]
            x, y = (boxes[k, 0], boxes[k, 1]) if post < 0 else (posts[post, 0], posts[post, 1])
            wide, high = extents[k]
            first, last = cell_of(x0, side, x - wide, columns), cell_of(x0, side, x + wide, columns)
            lowest, highest = cell_of(y0, side, y - high, rows), cell_of(y0, side, y + high, rows)
            for row in range(lowest, highest + 1):
                for column in range(first, last + 1):
                    east = x0 + (column + 0.5) * side - x
                    north = y0 + (row + 0.5) * side - y
                    if post < 0:
                        cos, sin = boxes[k, 4], boxes[k, 5]
                        turned = half * (abs(cos) + abs(sin))
                        apart = abs(cos * east + sin * north) > boxes[k, 2] + turned
                        apart = apart or abs(cos * north - sin * east) > boxes[k, 3] + turned
                    else:
                        apart = math.hypot(max(abs(east) - half, 0.0), max(abs(north) - half, 0.0)) > posts[post, 2]
                    if apart:
                        continue
                    cell = row * columns + column
                    if filling:
                        lists[ends[cell]] = k if post < 0 else -1 - post
                        ends[cell] += 1
                    else:
                        counts[cell + 1] += 1
                        most -= 1
                        if most < 0:
                            return counts[:0]
        if not filling:
            borders = (counts.size + np.cumsum(counts)).astype(np.int32)
            ends = borders.copy()
            lists = np.empty(borders[-1], dtype=np.int32)
            lists[: borders.size] = borders
    return lists


@njit(cache=True, error_model="numpy", forceinline=True)
def cell_of(begin, side, at, count):
    """Column or row (of `count` from `begin`) that contains a coordinate [m], or the nearest one."""
    return int(min(max((at - begin) / side, 0.0), count - 1.0))
