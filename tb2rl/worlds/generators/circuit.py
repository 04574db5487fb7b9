"""`circuit`: one closed corridor with bends to both sides, without junctions or dead ends.

It runs around a spanning tree of blocks of two by two fields, and so returns to where it began.
"""

from __future__ import annotations

import numpy as np

from tb2rl.worlds.generators.enclosure import NARROW, Shapes, Size, solvable
from tb2rl.worlds.generators.lattice import Field, spanning_tree, spread, walls
from tb2rl.worlds.world import World

CORRIDOR = (1.6, 1.0)  # [m] its width at difficulty 0 and 1, at least
WALL = 0.16  # [m] its thickness
_PASSAGE = 2 * NARROW / CORRIDOR[0]  # share of a corridor's width that is required as passage on a small floor
_USED = 0.75  # least share of the blocks in the tree; the others are solid


def circuit(rng: np.random.Generator, difficulty: float, size: Size) -> World:
    """Each stretch of the corridor has a width of its own."""
    narrowest = min(_fields(difficulty, length)[1] for length in size)
    return solvable(_draw, rng, difficulty, size, widest=_PASSAGE * narrowest)


def _draw(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    (columns, least_width), (rows, least_height) = (_fields(difficulty, length) for length in size)
    fields = int(rng.integers(int(np.ceil(_USED * columns * rows)), columns * rows + 1))
    joined = _around(spanning_tree(rng, columns, rows, fields))
    widths = spread(rng, size[0] - (2 * columns - 1) * WALL, least_width, 2 * columns)
    heights = spread(rng, size[1] - (2 * rows - 1) * WALL, least_height, 2 * rows)
    return walls(joined, widths, heights, WALL), []


def _fields(difficulty: float, length: float) -> tuple[int, float]:
    """Number of blocks along a side of the floor, and least width of their corridors [m]."""
    width = float(np.interp(difficulty, (0.0, 1.0), CORRIDOR))
    count = max(2, int((length + WALL) / (width + WALL) / 2))
    return count, min(width, (length - (2 * count - 1) * WALL) / (2 * count))


def _around(tree: set[frozenset[Field]]) -> set[frozenset[Field]]:
    """Pairs of adjacent fields along the way around a tree."""
    joined = set[frozenset[Field]]()
    for column, row in {field for pair in tree for field in pair}:
        x, y = 2 * column, 2 * row
        sides = {  # the neighbouring block, and the two fields on its side
            (column, row - 1): ((x, y), (x + 1, y)),
            (column, row + 1): ((x, y + 1), (x + 1, y + 1)),
            (column - 1, row): ((x, y), (x, y + 1)),
            (column + 1, row): ((x + 1, y), (x + 1, y + 1)),
        }
        for other, quarters in sides.items():
            if frozenset(((column, row), other)) in tree:  # one corridor there, and one back
                dx, dy = other[0] - column, other[1] - row
                joined |= {frozenset((quarter, (quarter[0] + dx, quarter[1] + dy))) for quarter in quarters}
            else:
                joined.add(frozenset(quarters))
    return joined
