"""`clutter`: posts and boxes at random positions; higher difficulty means more of them."""

import math

import numpy as np

from tb2rl.worlds.generators.generated import Shapes, Size, family

WALL_DISTANCE = 0.5  # [m] minimum distance from the outer wall to the centre of an obstacle
DENSITY = (0.1, 0.45)  # [1/m^2] number of obstacles per area at difficulty 0 and 1


@family
def clutter(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    """As many posts (radii of 0.1 to 0.3 m) as boxes (sides of 0.2 to 0.8 m, random yaws)."""
    count = round(float(np.interp(difficulty, (0.0, 1.0), DENSITY)) * size[0] * size[1])
    centres = rng.uniform(WALL_DISTANCE, np.array(size) - WALL_DISTANCE, (count, 2))
    posts = np.column_stack([centres[::2], rng.uniform(0.1, 0.3, len(centres[::2]))])
    sides = rng.uniform(0.2, 0.8, (len(centres[1::2]), 2))
    boxes = np.column_stack([centres[1::2], sides, rng.uniform(0.0, math.pi, len(sides))])
    return boxes.tolist(), posts.tolist()
