"""`circuit`: one closed corridor with bends to both sides, without junctions and dead ends.

The corridor runs around a spanning tree of blocks of two by two cells, and is closed for this reason.
"""

from itertools import pairwise

import numpy as np

from tb2rl.worlds.generators.generated import MIN_PASSAGE, Shapes, Size, solvable
from tb2rl.worlds.generators.lattice import Pairs, random_sizes, spanning_tree, walls
from tb2rl.worlds.world import World

CORRIDOR = (1.6, 1.0)  # [m] minimum width at difficulty 0 and 1
WALL = 0.16  # [m] thickness
_PASSAGE_SHARE = 2 * MIN_PASSAGE / CORRIDOR[0]  # highest ratio of passage to corridor width: the one at difficulty 0
_MIN_TREE = 0.75  # minimum share of the blocks in the tree; the other blocks are solid


def circuit(rng: np.random.Generator, difficulty: float, size: Size) -> World:
    """A circuit whose corridor varies in width."""
    narrowest = min(_blocks(difficulty, length)[1] for length in size)
    return solvable(_draw, rng, difficulty, size, max_passage=_PASSAGE_SHARE * narrowest)


def _draw(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    (columns, min_width), (rows, min_height) = (_blocks(difficulty, length) for length in size)
    block_count = int(rng.integers(int(np.ceil(_MIN_TREE * columns * rows)), columns * rows + 1))
    connections = _corridor_around(spanning_tree(rng, columns, rows, block_count))
    widths = random_sizes(rng, size[0] - (2 * columns - 1) * WALL, min_width, 2 * columns)
    heights = random_sizes(rng, size[1] - (2 * rows - 1) * WALL, min_height, 2 * rows)
    return walls(connections, widths, heights, WALL), []


def _blocks(difficulty: float, length: float) -> tuple[int, float]:
    """Number of blocks along a side of the floor, and minimum width of the corridor [m]."""
    width = float(np.interp(difficulty, (0.0, 1.0), CORRIDOR))
    count = max(2, int((length + WALL) / (width + WALL) / 2))
    return count, min(width, (length - (2 * count - 1) * WALL) / (2 * count))


def _corridor_around(tree: Pairs) -> Pairs:
    """Pairs of adjacent cells of the closed corridor around a tree of blocks."""
    connections = Pairs()
    for column, row in {block for pair in tree for block in pair}:
        x, y = 2 * column, 2 * row
        ring = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1), (x, y)]
        connections |= {frozenset(pair) for pair in pairwise(ring)}
    for pair in tree:  # joins two rings by two passages between the blocks
        (c0, r0), (c1, r1) = sorted(pair)
        dx, dy = c1 - c0, r1 - r0
        near = (2 * c0 + dx, 2 * r0 + dy), (2 * c0 + 1, 2 * r0 + 1)
        far = [(x + dx, y + dy) for x, y in near]
        connections -= {frozenset(near), frozenset(far)}
        connections |= {frozenset(passage) for passage in zip(near, far, strict=True)}
    return connections
