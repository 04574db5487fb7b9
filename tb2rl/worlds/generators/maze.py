"""`maze`: corridors with junctions and dead ends, wide with some loops, or narrow with hardly any.

A spanning tree by depth-first search, with some walls removed.
"""

from __future__ import annotations

import numpy as np

from tb2rl.worlds.generators.enclosure import Shapes, Size, solvable
from tb2rl.worlds.generators.lattice import neighbours, spanning_tree, walls
from tb2rl.worlds.world import World

CORRIDOR = (2.0, 1.2)  # [m] least width at difficulty 0 and 1
LOOPS = (0.3, 0.05)  # share of the remaining walls that is removed
WALL = 0.16  # [m] thickness: six corridors of 1.2 m fill 8 m


def maze(rng: np.random.Generator, difficulty: float, size: Size) -> World:
    """Corridors of the same width, as many as fit."""
    return solvable(_draw, rng, difficulty, size)


def _draw(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    width, loops = (float(np.interp(difficulty, (0.0, 1.0), ends)) for ends in (CORRIDOR, LOOPS))
    columns, rows = (max(2, int((length + WALL + 1e-9) / (width + WALL))) for length in size)
    joined = spanning_tree(rng, columns, rows)
    joined |= {pair for pair in neighbours(columns, rows) if rng.random() < loops}
    widths, heights = (
        [(length - (count - 1) * WALL) / count] * count for length, count in zip(size, (columns, rows), strict=True)
    )
    return walls(joined, widths, heights, WALL), []
