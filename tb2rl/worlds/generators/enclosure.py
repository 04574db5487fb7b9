"""Parts of every generated world: a closed wall around, a start, a goal, and a path between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.worlds.floor import SIDE, Floor
from tb2rl.worlds.world import BoxShape, PostShape, World

Size = tuple[float, float]  # of the floor in x and y [m]; its lower left corner is the origin
Shapes = tuple[Sequence[BoxShape], Sequence[PostShape]]

THICKNESS = 0.1  # [m] of the wall around
NARROW = 0.5  # [m] the narrowest passage of a path at difficulty 1, and twice that at 0
FREE = 1 / 3  # of the floor that can be reached from the start, at least
_MOST_CLEARANCE = 1.5  # [m] larger clearances count alike
_ATTEMPTS = 200


def solvable(
    draw: Callable[[np.random.Generator, float, Size], Shapes],
    rng: np.random.Generator,
    difficulty: float,
    size: Size,
    widest: float = math.inf,
) -> World:
    """Draw worlds until a robot can get from the start to at least `FREE` of the floor.

    The start is the place farthest from all walls, the goal the one with the longest path from there. The passages are
    as wide as the difficulty allows.

    Args:
        draw: Function from rng, difficulty and size to boxes and posts, without a wall around.
        rng: Random number generator.
        difficulty: From 0 to 1.
        size: Of the floor [m].
        widest: Upper limit of the required passage width [m], for small floors.

    Raises:
        InputError: If no such world is found.
    """
    passage = min(NARROW * (2.0 - difficulty), widest)
    for _ in range(_ATTEMPTS):
        world = _enclosed(*draw(rng, difficulty, size), size)
        floor = Floor.of(world, _MOST_CLEARANCE)
        start = floor.centre(*divmod(int(floor.clearance.argmax()), floor.clearance.shape[1]))
        # Half a square less than half the passage, because no centre of a square need be in the middle of a door.
        steps = floor.steps_from(*start, passage / 2 - SIDE / 2)
        if (steps >= 0).sum() * SIDE**2 >= FREE * size[0] * size[1]:
            goal = floor.centre(*divmod(int(steps.argmax()), steps.shape[1]))
            return replace(world, start=(*start, rng.uniform(-math.pi, math.pi)), goal=(*goal, 0.0))
    raise InputError(
        f"generator {draw.__module__.rpartition('.')[2]}: in {_ATTEMPTS} worlds of {size[0]:g} x {size[1]:g} m with "
        f"difficulty {difficulty:.2f} a robot gets to less than a third of the floor; "
        "try another difficulty, or a larger size"
    )


def _enclosed(boxes: Sequence[BoxShape], posts: Sequence[PostShape], size: Size) -> World:
    """A world with a wall around its floor, without a start yet."""
    (x, y), t = size, THICKNESS
    around = [
        (x / 2, -t / 2, x + 2 * t, t, 0.0),
        (x / 2, y + t / 2, x + 2 * t, t, 0.0),
        (-t / 2, y / 2, t, y, 0.0),
        (x + t / 2, y / 2, t, y, 0.0),
    ]
    return World.from_shapes("", [*around, *boxes], posts, start=(0.0, 0.0, 0.0), bounds=(-t, -t, x + t, y + t))
