"""`offices`: the floor of a building; higher difficulty means smaller rooms, narrower doors and more furniture.

Corridors divide the floor, walls divide what is left into rooms (binary space partitioning).
"""

import math
from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from tb2rl.worlds.generators.generated import Shapes, Size, family
from tb2rl.worlds.generators.rooms import wall_parts
from tb2rl.worlds.world import BoxShape

SIDE = (7.0, 4.0)  # [m] longest side of a room at difficulty 0 and 1
CORRIDOR = (2.4, 1.4)  # [m] width at difficulty 0 and 1
DOOR = (1.2, 0.8)  # [m] width at difficulty 0 and 1
FURNITURE = (0.03, 0.1)  # [1/m^2] boxes in rooms at difficulty 0 and 1
WALL = 0.05  # [m] thickness
SECOND_WAYS = 0.25  # probability of a door without which the floor is connected, too
_DIVISIONS_BY_CORRIDORS = 2  # further divisions are by walls
_MIN_WALL = 1.6  # [m] shortest wall that can have a door


class Area(NamedTuple):
    """A room or a corridor [m]."""

    x0: float
    y0: float
    x1: float
    y1: float
    is_corridor: bool = False


class Wall(NamedTuple):
    """A wall between two areas."""

    a: Area
    b: Area
    axis: int  # to which it is perpendicular
    at: float  # where it crosses this axis [m]
    first: float  # its ends along the other axis [m]
    last: float

    @property
    def is_at_corridor(self) -> bool:
        """Whether one of the areas is a corridor."""
        return self.a.is_corridor or self.b.is_corridor


@family
def offices(rng: np.random.Generator, difficulty: float, size: Size) -> Shapes:
    """Rooms with one door or several, corridors that branch, dead ends, and furniture."""
    side, corridor, door, furniture = (
        float(np.interp(difficulty, (0.0, 1.0), ends)) for ends in (SIDE, CORRIDOR, DOOR, FURNITURE)
    )
    areas = _divide(rng, Area(0.0, 0.0, *size), side, corridor, 0)
    boxes: list[BoxShape] = []
    connected = {area: {area} for area in areas}  # by doors
    walls = [wall for pair in combinations(areas, 2) for wall in _shared_walls(*pair)]
    # Doors to corridors first, so that most rooms have one.
    for a, b, axis, at, first, last in sorted(walls, key=lambda wall: (not wall.is_at_corridor, rng.random())):
        is_second_way = b in connected[a]
        has_door = last - first >= _MIN_WALL and (not is_second_way or rng.random() < SECOND_WAYS)
        if has_door and not is_second_way:
            joined = connected[a] | connected[b]
            connected |= dict.fromkeys(joined, joined)
        for centre, length in wall_parts(rng, first, last, door if has_door else 0.0):
            boxes.append((at, centre, WALL, length, 0.0) if axis == 0 else (centre, at, length, WALL, 0.0))
    for area in areas:
        width, height = area.x1 - area.x0, area.y1 - area.y0
        for _ in range(0 if area.is_corridor else rng.poisson(furniture * width * height)):
            x, y = rng.uniform((area.x0, area.y0), (area.x1, area.y1))
            boxes.append((x, y, *rng.uniform(0.2, 1.2, 2), rng.uniform(0.0, math.pi)))
    return boxes, []


def _divide(rng: np.random.Generator, area: Area, side: float, corridor: float, depth: int) -> list[Area]:
    """Divide an area across its longer side, until no side of a part is longer than `side` [m]."""
    lengths = area.x1 - area.x0, area.y1 - area.y0
    if max(lengths) <= side:
        return [area]
    axis = int(lengths[1] > lengths[0])
    gap = corridor if depth < _DIVISIONS_BY_CORRIDORS and lengths[axis] > 2 * side + corridor else 0.0
    middle = area[axis] + lengths[axis] * rng.uniform(0.35, 0.65)
    low, high = middle - gap / 2, middle + gap / 2
    x0, y0, x1, y1, _ = area
    if axis == 0:
        before, after, between = Area(x0, y0, low, y1), Area(high, y0, x1, y1), Area(low, y0, high, y1, True)
    else:
        before, after, between = Area(x0, y0, x1, low), Area(x0, high, x1, y1), Area(x0, low, x1, high, True)
    parts = [part for each in (before, after) for part in _divide(rng, each, side, corridor, depth + 1)]
    return [*parts, between] if gap else parts


def _shared_walls(a: Area, b: Area) -> Iterator[Wall]:
    """The wall between two areas, if there is one."""
    for axis in (0, 1):
        for left, right in ((a, b), (b, a)):
            first, last = max(a[1 - axis], b[1 - axis]), min(a[3 - axis], b[3 - axis])
            if left[2 + axis] == right[axis] and first < last:
                yield Wall(a, b, axis, left[2 + axis], first, last)
