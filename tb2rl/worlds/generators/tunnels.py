"""`tunnels`: a maze of corridors of different widths; higher difficulty means fewer loops and more crevices.

Crevices are corridors that are too narrow for a TurtleBot2, which a robot without a map has to find out.
"""

import numpy as np

from tb2rl.worlds.generators.generated import Shapes, Size, family
from tb2rl.worlds.generators.lattice import adjacent_pairs, spanning_tree, walls

WIDTH = (1.0, 2.0)  # [m] range of the widths of corridors
CREVICE = (0.2, 0.33)  # [m] range of the widths of crevices
CREVICES = (0.15, 0.35)  # share of crevices at difficulty 0 and 1
LOOPS = (0.3, 0.1)  # probability that a wall is removed, at difficulty 0 and 1
WALL = 0.05  # [m] thickness


@family
def tunnels(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    """Columns and rows of a maze, each with its own width."""
    crevices, loop_probability = (float(np.interp(difficulty, (0.0, 1.0), ends)) for ends in (CREVICES, LOOPS))
    widths, heights = (_widths(rng, length, crevices) for length in size)
    connections = spanning_tree(rng, len(widths), len(heights))
    pairs = adjacent_pairs(len(widths), len(heights))
    connections |= {pair for pair in pairs if rng.random() < loop_probability}
    return walls(connections, widths, heights, WALL), []


def _widths(rng: np.random.Generator, length: float, crevices: float) -> list[float]:
    """Widths of corridors that fill a length [m] with the walls between them; two crevices are never adjacent."""
    widths = [rng.uniform(*WIDTH)]
    while sum(widths) + WALL * len(widths) + WIDTH[1] < length:
        is_crevice = widths[-1] >= WIDTH[0] and rng.random() < crevices
        widths.append(rng.uniform(*(CREVICE if is_crevice else WIDTH)))
    return [*widths, length - sum(widths) - WALL * len(widths)]
