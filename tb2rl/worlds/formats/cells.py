"""Occupancy grids as boxes, and worlds as occupancy grids."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.values import Pose
from tb2rl.worlds.rectangles import rectangles
from tb2rl.worlds.world import BoxShape, World


def merge_cells(occupied: np.ndarray, side: float, origin: Pose) -> list[BoxShape]:
    """Cover the occupied cells with boxes that do not overlap: row by row or column by column, whichever takes fewer.

    Args:
        occupied: Mask of shape (rows, columns); row 0 is the lowest.
        side: Side of a cell [m].
        origin: Pose of the grid's lower left corner.
    """
    found, by_columns = rectangles(occupied), rectangles(occupied.T)
    if len(by_columns) < len(found):
        found = by_columns[:, [2, 3, 0, 1]]
    columns, rows = found[:, :2] * side, found[:, 2:] * side
    x, y = columns.mean(axis=1), rows.mean(axis=1)
    length, width = np.diff(columns)[:, 0], np.diff(rows)[:, 0]
    left, bottom, yaw = origin
    cos, sin = math.cos(yaw), math.sin(yaw)
    placed = left + cos * x - sin * y, bottom + sin * x + cos * y
    return [tuple(row) for row in np.column_stack([*placed, length, width, np.full(len(x), yaw)]).tolist()]


def occupied_cells(world: World, side: float) -> np.ndarray:
    """Mask of the cells with sides of `side` [m] whose centres are in an obstacle, (rows, columns); row 0 is lowest.

    An obstacle thinner than a cell is taken as one cell thick, so that no wall is lost.
    """
    x0, y0, x1, y1 = world.bounds
    columns, rows = (max(1, math.ceil((high - low) / side - 1e-6)) for low, high in ((x0, x1), (y0, y1)))
    occupied = np.zeros((rows, columns), dtype=bool)
    least = side / 2 * (1 + 1e-6)  # half a cell: a strip of one cell contains one centre at least
    for x, y, half_length, half_width, cos, sin in world.boxes.tolist():
        along, across = max(half_length, least), max(half_width, least)
        x_extent, y_extent = abs(along * cos) + abs(across * sin), abs(along * sin) + abs(across * cos)
        columns_near, east = _near(columns, x - x0, x_extent, side)
        rows_near, north = _near(rows, y - y0, y_extent, side)
        inside = np.abs(cos * east + sin * north[:, None]) <= along
        occupied[rows_near, columns_near] |= inside & (np.abs(cos * north[:, None] - sin * east) <= across)
    for x, y, radius in world.posts.tolist():
        most = max(radius, least * math.sqrt(2))  # half a diagonal: a small post contains one centre at least
        columns_near, east = _near(columns, x - x0, most, side)
        rows_near, north = _near(rows, y - y0, most, side)
        occupied[rows_near, columns_near] |= east**2 + north[:, None] ** 2 <= most**2
    return occupied


def _near(count: int, centre: float, extent: float, side: float) -> tuple[slice, np.ndarray]:
    """The cells of one axis within `extent` of `centre` [m], and the offsets of their centres [m]."""
    begin, end = math.floor((centre - extent) / side), math.ceil((centre + extent) / side)
    cells = slice(min(max(0, begin), count), min(max(0, end), count))
    return cells, (np.arange(cells.start, cells.stop) + 0.5) * side - centre
