"""A lattice of fields: spanning trees on it, and the walls between fields that are not joined."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from tb2rl.worlds.rectangles import rectangles
from tb2rl.worlds.world import BoxShape

Field = tuple[int, int]  # column, row


def spanning_tree(
    rng: np.random.Generator, columns: int, rows: int, fields: int | None = None
) -> set[frozenset[Field]]:
    """Pairs of neighbours in a random tree of `fields` fields, or of all, by depth-first search."""
    here = (int(rng.integers(columns)), int(rng.integers(rows)))
    path, met, joined = [here], {here}, set[frozenset[Field]]()
    while path and len(met) < (fields or columns * rows):
        column, row = path[-1]
        around = [(column + 1, row), (column, row + 1), (column - 1, row), (column, row - 1)]
        new = [f for f in around if f not in met and 0 <= f[0] < columns and 0 <= f[1] < rows]
        if new:
            chosen = new[int(rng.integers(len(new)))]
            joined.add(frozenset((path[-1], chosen)))
            met.add(chosen)
            path.append(chosen)
        else:
            path.pop()
    return joined


def neighbours(columns: int, rows: int) -> list[frozenset[Field]]:
    """All pairs of neighbours."""
    sideways = [frozenset(((c, r), (c + 1, r))) for c in range(columns - 1) for r in range(rows)]
    return sideways + [frozenset(((c, r), (c, r + 1))) for c in range(columns) for r in range(rows - 1)]


def walls(
    joined: set[frozenset[Field]], widths: Sequence[float], heights: Sequence[float], wall: float
) -> list[BoxShape]:
    """Boxes between fields that are not joined, and in place of fields that are joined to none.

    Args:
        joined: Pairs of neighbours without a wall between them.
        widths, heights: Of the columns and the rows [m].
        wall: Thickness of the walls [m].
    """
    columns, rows = len(widths), len(heights)
    solid = np.ones((2 * rows - 1, 2 * columns - 1), dtype=bool)  # walls are the odd rows and columns
    for pair in joined:
        (c0, r0), (c1, r1) = sorted(pair)
        for row, column in ((2 * r0, 2 * c0), (2 * r1, 2 * c1), (r0 + r1, c0 + c1)):
            solid[row, column] = False
    x, y = _edges(widths, wall), _edges(heights, wall)
    sides = [(x[left], x[right], y[low], y[high]) for left, right, low, high in rectangles(solid).tolist()]
    return [((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0) for x0, x1, y0, y1 in sides]


def _edges(sizes: Sequence[float], wall: float) -> list[float]:
    """Borders of the fields and of the walls between them [m]."""
    parts = [part for size in sizes for part in (size, wall)][:-1]
    return [0.0, *accumulate(parts)]


def spread(rng: np.random.Generator, total: float, least: float, count: int) -> list[float]:
    """`count` sizes of at least `least` [m] with the sum `total` [m]; the rest is distributed at random."""
    shares = rng.dirichlet(np.ones(count))
    return (least + (total - count * least) * shares).tolist()
