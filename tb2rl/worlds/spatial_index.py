"""Spatial index of worlds with many obstacles: a grid of square cells with a list of obstacles for each cell.

Worlds with few obstacles have no grid, because plain loops over all obstacles are faster there. Compiled code reads the
obstacles of all worlds from one table of boxes and one of posts, which are circles.
"""

import math
from collections import namedtuple
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tb2rl.core.compiled import njit

GRID_THRESHOLD = 100  # maximum number of obstacles without a grid; with so few, plain loops are faster for 36 beams
_MAX_ENTRIES_PER_OBSTACLE = 32  # mean over all obstacles; the cell side is doubled until the lists are short enough
_MIN_CELL_SIDE = 1e-6  # [m]
_SLACK = 1e-6  # share of the cell side; obstacles this close to a cell are in its list, in spite of rounding
# Columns of `SpatialIndex.worlds`, `boxes` and `posts`; numba compiles them as constants.
_World = namedtuple("_World", "x0 y0 cell_side columns rows first_cell first_box end_box first_post end_post")
_Box = namedtuple("_Box", "x y half_length half_width cos sin")
_Post = namedtuple("_Post", "x y radius")
WORLD, BOX, POST = _World(*range(10)), _Box(*range(6)), _Post(*range(3))


class SpatialIndex(NamedTuple):
    """Obstacles of one or more worlds, and the grids of these worlds."""

    boxes: np.ndarray  # rows of `World.boxes` of all worlds, concatenated
    posts: np.ndarray  # rows of `World.posts` of all worlds, concatenated
    # One row per world, shape (worlds, 10): x, y of the lower left corner of its grid and side of a cell [m]; columns
    # and rows of the grid (0 without a grid); position of its first cell in `cell_lists`; first and end row of its
    # boxes and of its posts (ends are exclusive).
    worlds: np.ndarray
    # The cell lists of each world with a grid, as compressed sparse rows. First, for each cell (lowest row first),
    # comes the position in this array where its obstacles begin and those of the previous cell end; then the end of
    # the last list; then the obstacles: k for row k of `boxes`, -1 - k for row k of `posts`.
    cell_lists: np.ndarray


def build_index(boxes: np.ndarray, posts: np.ndarray, grid_threshold: int = GRID_THRESHOLD) -> SpatialIndex:
    """Index one world of `boxes` (n, 6) and `posts` (n, 3), with a grid for more obstacles than `grid_threshold`."""
    grid, cell_lists = np.zeros(5), np.empty(0, dtype=np.int32)
    if len(boxes) + len(posts) > grid_threshold:
        grid, cell_lists = _make_grid(boxes, posts)
    return SpatialIndex(boxes, posts, np.array([[*grid, 0, 0, len(boxes), 0, len(posts)]]), cell_lists)


def join_indices(indices: Sequence[SpatialIndex]) -> SpatialIndex:
    """Combine the indices of single worlds into one."""
    if len(indices) == 1:
        return indices[0]
    worlds = np.concatenate([index.worlds for index in indices])
    for first, end in ((WORLD.first_box, WORLD.end_box), (WORLD.first_post, WORLD.end_post)):
        worlds[:, end] = np.cumsum(worlds[:, end])
        worlds[1:, first] = worlds[:-1, end]
    worlds[1:, WORLD.first_cell] = np.cumsum([len(index.cell_lists) for index in indices])[:-1]
    cell_lists = [index.cell_lists.copy() for index in indices]
    for world, cell_list in zip(worlds.astype(np.int32), cell_lists, strict=True):
        offset_count = world[WORLD.columns] * world[WORLD.rows] + 1
        cell_list[:offset_count] += world[WORLD.first_cell]
        entries = cell_list[offset_count:]
        entries += np.where(entries < 0, -world[WORLD.first_post], world[WORLD.first_box])
    boxes, posts = (np.concatenate([index[table] for index in indices]) for table in (0, 1))
    return SpatialIndex(boxes, posts, worlds, np.concatenate(cell_lists))


def bounding_boxes(boxes: np.ndarray, posts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres, and half sizes in x and y, of the bounding boxes of obstacles [m], boxes before posts, shape (n, 2)."""
    half_length, half_width, cos, sin = boxes[:, BOX.half_length :].T
    half_x, half_y = half_length * abs(cos) + half_width * abs(sin), half_length * abs(sin) + half_width * abs(cos)
    half_sizes = np.concatenate([np.column_stack([half_x, half_y]), posts[:, [POST.radius, POST.radius]]])
    return np.concatenate([boxes[:, :2], posts[:, :2]]), half_sizes


def _make_grid(boxes: np.ndarray, posts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Grid of a world, as the first five columns of `SpatialIndex.worlds`, and its `cell_lists`."""
    count, (centres, half_sizes) = len(boxes) + len(posts), bounding_boxes(boxes, posts)
    low, high = (centres - half_sizes).min(axis=0), (centres + half_sizes).max(axis=0)
    size = high - low
    # About as many cells as obstacles, because more cells lengthen the path of a ray, and fewer lengthen the lists.
    side = max(math.sqrt(size[0] * size[1] / count), size.max() / count, _MIN_CELL_SIDE)
    cells, entries = np.empty((2, _MAX_ENTRIES_PER_OBSTACLE * count), dtype=np.int32)
    while True:
        corner = low - 2 * _SLACK * side
        columns, rows = np.floor(size / side + 1.001)  # the grid ends beyond the last obstacle
        grid = np.array([*corner, side, columns, rows])
        pair_count = _list_obstacles(boxes, posts, centres, half_sizes, grid, cells, entries)
        if pair_count >= 0:
            cell_count = int(columns * rows)
            ends = np.bincount(cells[:pair_count], minlength=cell_count).cumsum()
            order = np.argsort(cells[:pair_count], kind="stable")
            return grid, np.concatenate([[cell_count + 1], cell_count + 1 + ends, entries[order]]).astype(np.int32)
        side *= 2.0


@njit(cache=True)
def _list_obstacles(boxes, posts, centres, half_sizes, grid, cells, entries):
    """Write each pair of a cell and an obstacle in it to `cells` and `entries`.

    Args:
        boxes, posts: See `SpatialIndex`.
        centres, half_sizes: See `bounding_boxes`.
        grid: First five columns of `SpatialIndex.worlds`.
        cells: Result, the cell of each pair.
        entries: Result, the obstacle of each pair, as in `SpatialIndex.cell_lists`.

    Returns:
        Number of pairs; -1 if they are more than `cells` can hold.
    """
    x0, y0, side = grid[WORLD.x0], grid[WORLD.y0], grid[WORLD.cell_side]
    columns, rows = int(grid[WORLD.columns]), int(grid[WORLD.rows])
    half, pair_count = (0.5 + _SLACK) * side, 0  # half the side of a cell, with slack
    for k in range(half_sizes.shape[0]):
        post = k - boxes.shape[0]
        (x, y), (half_x, half_y) = centres[k], half_sizes[k]
        left, right = cell_of(x0, side, x - half_x, columns), cell_of(x0, side, x + half_x, columns)
        bottom, top = cell_of(y0, side, y - half_y, rows), cell_of(y0, side, y + half_y, rows)
        for row in range(bottom, top + 1):
            for column in range(left, right + 1):
                dx, dy = x0 + (column + 0.5) * side - x, y0 + (row + 0.5) * side - y
                if post < 0:
                    cos, sin = boxes[k, BOX.cos], boxes[k, BOX.sin]
                    half_projection = half * (abs(cos) + abs(sin))
                    is_apart = abs(cos * dx + sin * dy) > boxes[k, BOX.half_length] + half_projection
                    is_apart = is_apart or abs(cos * dy - sin * dx) > boxes[k, BOX.half_width] + half_projection
                else:
                    is_apart = math.hypot(max(abs(dx) - half, 0.0), max(abs(dy) - half, 0.0)) > posts[post, POST.radius]
                if is_apart:
                    continue
                if pair_count == cells.size:
                    return -1
                cells[pair_count], entries[pair_count] = row * columns + column, k if post < 0 else -1 - post
                pair_count += 1
    return pair_count


@njit(cache=True, error_model="numpy", forceinline=True)
def cell_of(grid_begin, side, coordinate, count):
    """Column (row) of the cell nearest to an x (y) coordinate [m], in a grid of `count` columns (rows)."""
    return int(min(max((coordinate - grid_begin) / side, 0.0), count - 1.0))
