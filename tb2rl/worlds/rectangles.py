"""Occupied cells of a grid as few rectangles that do not overlap.

Rectangles are rows of first column, end column, first row, end row, shape (n, 4); the ends are exclusive.
"""

from __future__ import annotations

import numpy as np


def rectangles(occupied: np.ndarray) -> np.ndarray:
    """Rectangles that cover the occupied cells of a mask (rows, columns)."""
    padded = np.zeros((len(occupied), occupied.shape[1] + 2), dtype=np.int8)
    padded[:, 1:-1] = occupied
    change = np.diff(padded, axis=1)
    (row, begin), (_, end) = np.nonzero(change == 1), np.nonzero(change == -1)
    return stack_runs(row, begin, end)


def stack_runs(row: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Join runs of cells, each in a row from column `begin` to before `end`, with equal runs in adjacent rows."""
    order = np.lexsort((row, end, begin))
    begin, end, row = begin[order], end[order], row[order]
    first = np.ones(len(row), dtype=bool)  # of each stack
    first[1:] = (np.diff(begin) != 0) | (np.diff(end) != 0) | (np.diff(row) != 1)
    last = np.append(first[1:], np.ones(min(len(row), 1), dtype=bool))
    return np.column_stack([begin[first], end[first], row[first], row[last] + 1])
