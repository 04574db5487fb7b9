"""A grid of cells that are occupied or free, as few boxes; and the obstacles of a world as such a grid."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.values import Pose
from tb2rl.worlds.world import BoxShape, World


def merge_cells(occupied: np.ndarray, side: float, origin: Pose) -> list[BoxShape]:
    """The occupied cells as boxes that do not overlap.

    Cells in a row are joined to runs, and runs that begin and end in the same columns to one box; or the same with rows
    and columns swapped, whichever makes fewer boxes.

    Args:
        occupied: Which cells are, shape (rows, columns); row 0 is the lowest.
        side: Of a cell [m].
        origin: Pose of the grid's lower left corner.

    Returns:
        x, y, length, width [m], yaw [rad] of each box.
    """
    by_rows, by_columns = _rectangles(occupied), _rectangles(occupied.T)
    if len(by_columns) < len(by_rows):
        by_rows = by_columns[:, [2, 3, 0, 1]]
    columns, rows = by_rows[:, :2] * side, by_rows[:, 2:] * side
    x, y = columns.mean(axis=1), rows.mean(axis=1)
    length, width = np.diff(columns)[:, 0], np.diff(rows)[:, 0]
    left, bottom, yaw = origin
    cos, sin = math.cos(yaw), math.sin(yaw)
    placed = left + cos * x - sin * y, bottom + sin * x + cos * y
    return [tuple(row) for row in np.column_stack([*placed, length, width, np.full(len(x), yaw)]).tolist()]


def _rectangles(occupied: np.ndarray) -> np.ndarray:
    """First column, the one after the last, first row, the one after the last, of each box; shape (boxes, 4)."""
    padded = np.zeros((len(occupied), occupied.shape[1] + 2), dtype=np.int8)
    padded[:, 1:-1] = occupied
    change = np.diff(padded, axis=1)
    (row, begin), (_, end) = np.nonzero(change == 1), np.nonzero(change == -1)
    order = np.lexsort((row, end, begin))
    begin, end, row = begin[order], end[order], row[order]
    first = np.ones(len(row), dtype=bool)  # of each stack of equal runs
    first[1:] = (np.diff(begin) != 0) | (np.diff(end) != 0) | (np.diff(row) != 1)
    last = np.append(first[1:], np.ones(min(len(row), 1), dtype=bool))
    return np.column_stack([begin[first], end[first], row[first], row[last] + 1])


def occupied_cells(world: World, side: float) -> np.ndarray:
    """Which cells of the world's rectangle are occupied, shape (rows, columns); row 0 is the lowest.

    A cell is, if an obstacle covers its centre. What is thinner than a cell is taken as one cell thick, so that no wall
    is lost.

    Args:
        world: The world.
        side: Of a cell [m].
    """
    x0, y0, x1, y1 = world.bounds
    columns, rows = (max(1, math.ceil((high - low) / side - 1e-6)) for low, high in ((x0, x1), (y0, y1)))
    occupied = np.zeros((rows, columns), dtype=bool)
    least = side / 2 * (1 + 1e-6)  # half a cell: a strip of one cell meets one centre at least
    for x, y, half_length, half_width, cos, sin in world.boxes.tolist():
        along, across = max(half_length, least), max(half_width, least)
        reach_x, reach_y = abs(along * cos) + abs(across * sin), abs(along * sin) + abs(across * cos)
        window, east, north = _around(occupied, (x - x0, y - y0), (reach_x, reach_y), side)
        window |= (np.abs(cos * east + sin * north) <= along) & (np.abs(cos * north - sin * east) <= across)
    for x, y, radius in world.posts.tolist():
        reach = max(radius, least * math.sqrt(2))  # half a diagonal: a small post meets one centre at least
        window, east, north = _around(occupied, (x - x0, y - y0), (reach, reach), side)
        window |= east**2 + north**2 <= reach**2
    return occupied


def _around(
    cells: np.ndarray, centre: tuple[float, float], reach: tuple[float, float], side: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cells around a point, and how far their centres lie from it: to the east (1, n), to the north (m, 1) [m]."""
    spans = []
    for axis, count in ((0, cells.shape[1]), (1, cells.shape[0])):
        low, high = ((centre[axis] + sign * reach[axis]) / side for sign in (-1, 1))
        spans.append(slice(min(max(0, math.floor(low)), count), min(max(0, math.ceil(high)), count)))
    across, up = spans
    east = (np.arange(across.start, across.stop) + 0.5) * side - centre[0]
    north = (np.arange(up.start, up.stop) + 0.5) * side - centre[1]
    return cells[up, across], east[None, :], north[:, None]
