"""How far it is to a square from all squares of a floor, by fast marching.

Sethian 1996, "A fast marching level set method for monotonically advancing fronts": unlike steps from square to
square it knows every direction.
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import njit

_BEYOND = 3.0  # times as long as it is, off all ways, where only rounding gets to


@njit(cache=True, nogil=True)
def march(dear, row, column, side):
    """How far it is to the square `row`, `column` [m] from all squares, shape (rows, columns), float32.

    Args:
        dear: How many times as long as it is a way over each square counts, 0: there is none, shape (rows, columns).
        row, column: Where the goal is.
        side: Of a square [m].
    """
    rows, columns = dear.shape
    far = np.full((rows, columns), np.inf)
    far[row, column] = 0.0
    keys, cells, size = np.empty(8 * rows * columns), np.empty(8 * rows * columns, dtype=np.int64), 0
    size = _push(keys, cells, size, 0.0, row * columns + column)
    while size:
        i, j, key = cells[0] // columns, cells[0] % columns, keys[0]
        size = _pop(keys, cells, size)
        if key > far[i, j]:
            continue  # a shorter way was found since
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = i + down, j + right
            if not (0 <= r < rows and 0 <= c < columns) or dear[r, c] == 0.0:
                continue
            step = side * dear[r, c]
            across = min(far[r, c - 1] if c > 0 else np.inf, far[r, c + 1] if c + 1 < columns else np.inf)
            along = min(far[r - 1, c] if r > 0 else np.inf, far[r + 1, c] if r + 1 < rows else np.inf)
            way = min(across, along) + step
            if abs(across - along) < step:
                way = 0.5 * (across + along + math.sqrt(2.0 * step * step - (across - along) ** 2))
            if way < far[r, c]:
                far[r, c] = way
                size = _push(keys, cells, size, way, r * columns + c)
    _go_on_beyond(far, cells, side)
    return far.astype(np.float32)


@njit(cache=True, nogil=True)
def _go_on_beyond(far, queue, side):
    """Let squares without a way be as far as the nearest one with a way, and `_BEYOND` times the way there.

    The nearest, and not the one that leads on best: else what is on the other side of a thin wall would count here.

    Args:
        far: Of each square [m], inf: without a way, shape (rows, columns).
        queue: Room for their numbers.
        side: Of a square [m].
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
                far[r, c] = far[i, j] + _BEYOND * side
                queue[last], last = r * columns + c, last + 1


@njit(cache=True, nogil=True)
def _push(keys, cells, size, key, cell):
    """Put a cell on the heap of which `size` places are used; the new size."""
    at = size
    while at > 0 and keys[(at - 1) // 2] > key:
        keys[at], cells[at] = keys[(at - 1) // 2], cells[(at - 1) // 2]
        at = (at - 1) // 2
    keys[at], cells[at] = key, cell
    return size + 1


@njit(cache=True, nogil=True)
def _pop(keys, cells, size):
    """Take the cell with the least key from the heap; the new size."""
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
