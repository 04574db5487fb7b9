"""Path lengths from all squares of a floor to one of them, by fast marching.

Sethian 1996, "A fast marching level set method for monotonically advancing fronts": unlike steps between neighbours, it
is not biased towards the axes.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import njit

_UNREACHABLE_COST = 3.0  # factor on the length outside of the reachable floor, where only rounding errors lead


@njit(cache=True, nogil=True)
def march(costs, row, column, side):
    """Path length from all squares to the square `row`, `column` [m], shape (rows, columns), float32.

    Args:
        costs: Factor on the length of a path over each square, 0 for blocked squares, shape (rows, columns).
        row, column: Square of the goal.
        side: Side of a square [m].
    """
    rows, columns = costs.shape
    far = np.full((rows, columns), np.inf)
    far[row, column] = 0.0
    keys, cells, size = np.empty(8 * rows * columns), np.empty(8 * rows * columns, dtype=np.int64), 0
    size = _push(keys, cells, size, 0.0, row * columns + column)
    while size:
        i, j, key = cells[0] // columns, cells[0] % columns, keys[0]
        size = _pop(keys, cells, size)
        if key > far[i, j]:
            continue  # a shorter path has been found since
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = i + down, j + right
            if not (0 <= r < rows and 0 <= c < columns) or costs[r, c] == 0.0:
                continue
            step = side * costs[r, c]
            across = min(far[r, c - 1] if c > 0 else np.inf, far[r, c + 1] if c + 1 < columns else np.inf)
            along = min(far[r - 1, c] if r > 0 else np.inf, far[r + 1, c] if r + 1 < rows else np.inf)
            length = min(across, along) + step
            if abs(across - along) < step:
                length = 0.5 * (across + along + math.sqrt(2.0 * step * step - (across - along) ** 2))
            if length < far[r, c]:
                far[r, c] = length
                size = _push(keys, cells, size, length, r * columns + c)
    _extend(far, cells, side)
    return far.astype(np.float32)


@njit(cache=True, nogil=True)
def _extend(far, queue, side):
    """Give unreachable squares the length of the nearest reachable one, plus `_UNREACHABLE_COST` times the distance.

    Not the square with the shortest continuation: it might be on the other side of a thin wall.

    Args:
        far: Path lengths [m], inf where unreachable, shape (rows, columns); changed in place.
        queue: Scratch memory for the numbers of squares.
        side: Side of a square [m].
    """
    rows, columns = far.shape
    first, last = 0, 0
    for i in range(rows):
        for j in range(columns):
            if np.isfinite(far[i, j]):
                queue[last], last = i * columns + j, last + 1
    while first < last:
        i, j = queue[first] // columns, queue[first] % columns
        first += 1
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = i + down, j + right
            if 0 <= r < rows and 0 <= c < columns and not np.isfinite(far[r, c]):
                far[r, c] = far[i, j] + _UNREACHABLE_COST * side
                queue[last], last = r * columns + c, last + 1


@njit(cache=True, nogil=True)
def _push(keys, cells, size, key, cell):
    """Add a cell to the heap of `size` entries; return the new size."""
    at = size
    while at > 0 and keys[(at - 1) // 2] > key:
        keys[at], cells[at] = keys[(at - 1) // 2], cells[(at - 1) // 2]
        at = (at - 1) // 2
    keys[at], cells[at] = key, cell
    return size + 1


@njit(cache=True, nogil=True)
def _pop(keys, cells, size):
    """Remove the cell with the least key from the heap; return the new size."""
    size -= 1
    key, cell, at = keys[size], cells[size], 0
    while 2 * at + 1 < size:
        below = 2 * at + 1
        if below + 1 < size and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= key:
            break
        keys[at], cells[at] = keys[below], cells[below]
        at = below
    keys[at], cells[at] = key, cell
    return size
