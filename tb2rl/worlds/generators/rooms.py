"""`rooms`: rooms in rows and columns; higher difficulty means more rooms and narrower doors."""

from itertools import pairwise

import numpy as np

from tb2rl.worlds.generators.generated import MIN_PASSAGE, Shapes, Size, family
from tb2rl.worlds.generators.lattice import adjacent_pairs, spanning_tree
from tb2rl.worlds.world import BoxShape

SIDE = (4.0, 2.6)  # [m] approximate side of a room at difficulty 0 and 1
DOOR = (1.2, MIN_PASSAGE)  # [m] width at difficulty 0 and 1
WALL = 0.1  # [m] thickness
EXTRA_DOORS = 0.3  # probability of a door that is not in the spanning tree
_CORNER_DISTANCE = 0.15  # [m] minimum distance between a door and a corner


@family
def rooms(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    """Rooms that are all connected, some by several paths."""
    side, door_width = (float(np.interp(difficulty, (0.0, 1.0), ends)) for ends in (SIDE, DOOR))
    columns, rows = (max(2, round(length / side)) for length in size)
    x, y = _borders(rng, columns, size[0]), _borders(rng, rows, size[1])
    tree = spanning_tree(rng, columns, rows)
    boxes: list[BoxShape] = []
    for pair in adjacent_pairs(columns, rows):
        (c0, r0), (c1, r1) = sorted(pair)
        width = door_width if rng.random() < EXTRA_DOORS or pair in tree else 0.0
        if c1 > c0:
            boxes += ((x[c1], centre, WALL, w, 0.0) for centre, w in wall_parts(rng, y[r0], y[r0 + 1], width))
        else:
            boxes += ((centre, y[r1], w, WALL, 0.0) for centre, w in wall_parts(rng, x[c0], x[c0 + 1], width))
    return boxes, []


def _borders(rng: np.random.Generator, count: int, length: float) -> list[float]:
    """Borders [m] of `count` rooms of nearly the same size."""
    step = length / count
    return [0.0, *(step * (np.arange(1, count) + rng.uniform(-0.15, 0.15, count - 1))).tolist(), length]


def wall_parts(rng: np.random.Generator, first: float, last: float, door_width: float) -> list[tuple[float, float]]:
    """Centre and length of each part of a wall [m], with a door at a random position unless its width is 0."""
    first, last = first - WALL / 2, last + WALL / 2  # walls overlap at corners
    ends = [first, last]
    if door_width > 0.0:
        margin = WALL + _CORNER_DISTANCE
        begin = rng.uniform(first + margin, last - margin - door_width)
        ends = [first, begin, begin + door_width, last]
    return [((a + b) / 2, b - a) for a, b in list(pairwise(ends))[::2]]
