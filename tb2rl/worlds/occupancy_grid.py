"""Occupancy grids: conversion of grids to boxes, and of worlds to grids.

Rectangles of cells are arrays of shape (n, 4): first column, end column, first row, end row (ends are exclusive).
"""

import math

import numpy as np

from tb2rl.core.values import Pose
from tb2rl.worlds.floor import limit_to_obstacles
from tb2rl.worlds.spatial_index import BOX, POST
from tb2rl.worlds.world import BoxShape, World


def merge_cells(occupied: np.ndarray, side: float, origin: Pose) -> list[BoxShape]:
    """Cover occupied cells with boxes that do not overlap.

    The boxes are merged from runs of cells in rows, or in columns if these give fewer boxes.

    Args:
        occupied: Mask of shape (rows, columns); row 0 is the lowest.
        side: Side of a cell [m].
        origin: Pose of the grid's lower left corner.
    """
    by_rows, by_columns = find_rectangles(occupied), find_rectangles(occupied.T)[:, [2, 3, 0, 1]]
    rectangles = by_columns if len(by_columns) < len(by_rows) else by_rows
    columns, rows = rectangles[:, :2] * side, rectangles[:, 2:] * side
    x, y = columns.mean(axis=1), rows.mean(axis=1)
    length, width = np.diff(columns)[:, 0], np.diff(rows)[:, 0]
    left, bottom, yaw = origin
    cos, sin = math.cos(yaw), math.sin(yaw)
    centres = left + cos * x - sin * y, bottom + sin * x + cos * y
    return [tuple(row) for row in np.column_stack([*centres, length, width, np.full(len(x), yaw)]).tolist()]


def find_rectangles(occupied: np.ndarray) -> np.ndarray:
    """Cover the occupied cells of a mask (rows, columns) with rectangles that do not overlap."""
    padded = np.zeros((len(occupied), occupied.shape[1] + 2), dtype=np.int8)
    padded[:, 1:-1] = occupied
    change = np.diff(padded, axis=1)
    (row, begin), (_, end) = np.nonzero(change == 1), np.nonzero(change == -1)
    return stack_runs(row, begin, end)


def stack_runs(row: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Merge equal runs of cells in adjacent rows into rectangles.

    A run consists of the columns from `begin` to `end` - 1 in a `row`; all arguments have the shape (runs,).
    """
    order = np.lexsort((row, end, begin))
    begin, end, row = begin[order], end[order], row[order]
    is_first = np.ones(len(row), dtype=bool)  # whether a run is the lowest of its rectangle
    is_first[1:] = (np.diff(begin) != 0) | (np.diff(end) != 0) | (np.diff(row) != 1)
    is_last = np.append(is_first[1:], np.ones(min(len(row), 1), dtype=bool))
    return np.column_stack([begin[is_first], end[is_first], row[is_first], row[is_last] + 1])


def occupied_cells(world: World, side: float) -> np.ndarray:
    """Mask of the cells of size `side` [m] whose centres are in an obstacle, shape (rows, columns).

    Row 0 is the lowest. Obstacles thinner than a cell are enlarged to one cell, so that no wall is lost.
    """
    x0, y0, x1, y1 = world.bounds
    columns, rows = (max(1, math.ceil(length / side - 1e-6)) for length in (x1 - x0, y1 - y0))
    x, y = (np.arange(columns) + 0.5) * side, (np.arange(rows) + 0.5) * side
    boxes, posts = world.boxes - (x0, y0, 0, 0, 0, 0), world.posts - (x0, y0, 0)
    half_cell = side / 2 * (1 + 1e-6)  # a strip of one cell contains at least one centre
    half_sizes = [BOX.half_length, BOX.half_width]
    boxes[:, half_sizes] = np.maximum(boxes[:, half_sizes], half_cell)
    posts[:, POST.radius] = np.maximum(posts[:, POST.radius], half_cell * math.sqrt(2))  # half the diagonal of a cell
    clearance = np.full((rows, columns), np.inf)
    limit_to_obstacles(boxes, posts, x, y, side, clearance)
    return clearance == 0.0
