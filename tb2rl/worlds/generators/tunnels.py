"""`tunnels`: a maze of corridors of different widths; higher difficulty means narrower ones, and more crevices.

Crevices are corridors that are too narrow for a TurtleBot2, which a robot without a map has to find out.
"""

import numpy as np

from tb2rl.worlds.generators.generated import Shapes, Size, family
from tb2rl.worlds.generators.lattice import adjacent_pairs, spanning_tree, walls

LEAST_WIDTH = 1.0  # [m] of a corridor
LARGEST_WIDTH = (2.6, 1.6)  # [m] of a corridor at difficulty 0 and 1
CREVICE = (0.2, 0.33)  # [m] range of the widths of crevices
CREVICES = (0.05, 0.35)  # share of crevices at difficulty 0 and 1
LOOPS = (0.4, 0.3)  # probability that a wall is removed, at difficulty 0 and 1
WALL = 0.05  # [m] thickness


@family
def tunnels(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    """Columns and rows of a maze, each with its own width."""
    largest_width, crevices, loop_probability = (
        float(np.interp(difficulty, (0.0, 1.0), ends)) for ends in (LARGEST_WIDTH, CREVICES, LOOPS)
    )
    widths, heights = (_widths(rng, length, largest_width, crevices) for length in size)
    connections = spanning_tree(rng, len(widths), len(heights))
    pairs = adjacent_pairs(len(widths), len(heights))
    connections |= {pair for pair in pairs if rng.random() < loop_probability}
    return walls(connections, widths, heights, WALL), []


def _widths(rng: np.random.Generator, length: float, largest: float, crevices: float) -> list[float]:
    """Widths of corridors that fill a length [m] with the walls between them; two crevices are never adjacent."""
    widths: list[float] = []
    while (rest := length - sum(widths) - WALL * len(widths)) > largest:
        is_crevice = bool(widths) and widths[-1] > CREVICE[1] and rng.random() < crevices
        width = rng.uniform(*(CREVICE if is_crevice else (LEAST_WIDTH, largest)))
        widths.append(min(width, rest - WALL - LEAST_WIDTH))  # so that the last one is no crevice
    return [*widths, rest]
