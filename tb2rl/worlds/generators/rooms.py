"""`rooms`: rooms in rows and columns with doors between them: few rooms and wide doors, or many and narrow ones."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tb2rl.worlds.generators.enclosure import NARROW, Shapes, Size, solvable
from tb2rl.worlds.generators.lattice import neighbours, spanning_tree
from tb2rl.worlds.world import BoxShape, World

SIDE = (4.0, 2.6)  # [m] approximate side of a room at difficulty 0 and 1
DOOR = (1.2, NARROW)  # [m] width at difficulty 0 and 1
WALL = 0.1  # [m] thickness
EXTRA = 0.3  # probability of a door that the tree does not need
_CORNER = 0.15  # [m] between a door and the end of its wall


def rooms(rng: np.random.Generator, difficulty: float, size: Size) -> World:
    """Every room can be reached, some of them by several paths."""
    return solvable(_draw, rng, difficulty, size)


def _draw(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    side, door = (float(np.interp(difficulty, (0.0, 1.0), ends)) for ends in (SIDE, DOOR))
    columns, rows = (max(2, round(length / side)) for length in size)
    x, y = _lines(rng, columns, size[0]), _lines(rng, rows, size[1])
    doors = spanning_tree(rng, columns, rows)
    boxes: list[BoxShape] = []
    for pair in neighbours(columns, rows):
        (c0, r0), (c1, r1) = sorted(pair)
        has_door = rng.random() < EXTRA or pair in doors
        if c1 > c0:
            boxes += ((x[c1], m, WALL, w, 0.0) for m, w in _pieces(rng, y[r0], y[r0 + 1], door, has_door))
        else:
            boxes += ((m, y[r1], w, WALL, 0.0) for m, w in _pieces(rng, x[c0], x[c0 + 1], door, has_door))
    return boxes, []


def _lines(rng: np.random.Generator, count: int, length: float) -> list[float]:
    """Borders [m] of `count` rooms of nearly the same size."""
    step = length / count
    return [0.0, *(step * (np.arange(1, count) + rng.uniform(-0.15, 0.15, count - 1))).tolist(), length]


def _pieces(
    rng: np.random.Generator, first: float, last: float, door: float, has_door: bool
) -> list[tuple[float, float]]:
    """Centre and length [m] of the parts of a wall with a door of this width at a random place; corners are filled."""
    first, last = first - WALL / 2, last + WALL / 2
    ends = [first, last]
    if has_door:
        free = WALL + _CORNER
        begin = rng.uniform(first + free, last - free - door)
        ends = [first, begin, begin + door, last]
    return [((a + b) / 2, b - a) for a, b in list(pairwise(ends))[::2]]
