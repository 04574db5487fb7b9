"""`maze`: corridors with junctions and dead ends; higher difficulty means narrower corridors and fewer loops.

The maze is a spanning tree by depth-first search, with some walls removed.
"""

import numpy as np

from tb2rl.worlds.generators.generated import Shapes, Size, family
from tb2rl.worlds.generators.lattice import adjacent_pairs, spanning_tree, walls

CORRIDOR = (2.0, 1.2)  # [m] minimum width at difficulty 0 and 1
LOOPS = (0.3, 0.05)  # probability that a wall is removed, at difficulty 0 and 1
WALL = 0.16  # [m] thickness; six corridors of 1.2 m and the walls between them fill 8 m


@family
def maze(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    """A maze of equally wide corridors, as many as fit."""
    width, loop_probability = (float(np.interp(difficulty, (0.0, 1.0), ends)) for ends in (CORRIDOR, LOOPS))
    counts = columns, rows = [max(2, int((length + WALL + 1e-9) / (width + WALL))) for length in size]
    connections = spanning_tree(rng, columns, rows)
    connections |= {pair for pair in adjacent_pairs(columns, rows) if rng.random() < loop_probability}
    widths, heights = ([(length - (n - 1) * WALL) / n] * n for length, n in zip(size, counts, strict=True))
    return walls(connections, widths, heights, WALL), []
