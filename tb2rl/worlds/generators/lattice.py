"""Grid mazes: spanning trees of cells, and walls between cells that are not connected."""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from tb2rl.worlds.occupancy_grid import find_rectangles
from tb2rl.worlds.world import BoxShape

Cell = tuple[int, int]  # column, row
Pairs = set[frozenset[Cell]]  # pairs of adjacent cells


def spanning_tree(rng: np.random.Generator, columns: int, rows: int, count: int | None = None) -> Pairs:
    """Edges of a random tree of `count` cells (None: all cells), by depth-first search."""
    start = (int(rng.integers(columns)), int(rng.integers(rows)))
    path, visited, connections = [start], {start}, Pairs()
    while path and len(visited) < (count or columns * rows):
        column, row = path[-1]
        adjacent = [(column + 1, row), (column, row + 1), (column - 1, row), (column, row - 1)]
        unvisited = [c for c in adjacent if c not in visited and 0 <= c[0] < columns and 0 <= c[1] < rows]
        if unvisited:
            chosen = unvisited[int(rng.integers(len(unvisited)))]
            connections.add(frozenset((path[-1], chosen)))
            visited.add(chosen)
            path.append(chosen)
        else:
            path.pop()
    return connections


def adjacent_pairs(columns: int, rows: int) -> list[frozenset[Cell]]:
    sideways = [frozenset(((c, r), (c + 1, r))) for c in range(columns - 1) for r in range(rows)]
    return sideways + [frozenset(((c, r), (c, r + 1))) for c in range(columns) for r in range(rows - 1)]


def walls(connections: Pairs, widths: Sequence[float], heights: Sequence[float], thickness: float) -> list[BoxShape]:
    """Walls between cells that are not connected; cells without a connection are solid.

    Args:
        connections: Pairs of adjacent cells without a wall between them.
        widths, heights: Sizes of columns and rows [m].
        thickness: Thickness of the walls [m].
    """
    columns, rows = len(widths), len(heights)
    solid = np.ones((2 * rows - 1, 2 * columns - 1), dtype=bool)  # walls are the odd rows and columns
    for pair in connections:
        (c0, r0), (c1, r1) = sorted(pair)
        for row, column in ((2 * r0, 2 * c0), (2 * r1, 2 * c1), (r0 + r1, c0 + c1)):
            solid[row, column] = False
    x, y = _borders(widths, thickness), _borders(heights, thickness)
    rectangles = [(x[left], x[right], y[low], y[high]) for left, right, low, high in find_rectangles(solid).tolist()]
    return [((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0) for x0, x1, y0, y1 in rectangles]


def _borders(sizes: Sequence[float], thickness: float) -> list[float]:
    """Borders of cells and of the walls between them [m]."""
    return [0.0, *accumulate([part for size in sizes for part in (size, thickness)][:-1])]


def random_sizes(rng: np.random.Generator, total: float, min_size: float, count: int) -> list[float]:
    """Draw `count` random sizes of at least `min_size` [m] with the sum `total` [m]."""
    return (min_size + (total - count * min_size) * rng.dirichlet(np.ones(count))).tolist()
