"""`clutter`: posts and boxes anywhere, few and far apart, or many and close."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.worlds.generators.enclosure import Shapes, Size, solvable
from tb2rl.worlds.world import World

EDGE = 0.5  # [m] least distance from the wall around to the centre of an obstacle
DENSITY = (0.1, 0.45)  # [1/m^2] obstacles at difficulty 0 and 1


def clutter(rng: np.random.Generator, difficulty: float, size: Size) -> World:
    """Half posts of 0.1 to 0.3 m, half boxes with sides of 0.2 to 0.8 m, turned anyhow."""
    return solvable(_draw, rng, difficulty, size)


def _draw(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    count = round(float(np.interp(difficulty, (0.0, 1.0), DENSITY)) * size[0] * size[1])
    places = rng.uniform(EDGE, np.array(size) - EDGE, (count, 2))
    posts = np.column_stack([places[::2], rng.uniform(0.1, 0.3, len(places[::2]))])
    sides = rng.uniform(0.2, 0.8, (len(places[1::2]), 2))
    boxes = np.column_stack([places[1::2], sides, rng.uniform(0.0, math.pi, len(sides))])
    return boxes.tolist(), posts.tolist()
