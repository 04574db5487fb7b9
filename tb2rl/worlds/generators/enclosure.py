"""What every generated world has: a closed wall around, a start, a goal, and a way from one to the other."""

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
NARROW = 0.5  # [m] the narrowest passage that a way needs at difficulty 1, and twice that at 0
FREE = 1 / 3  # of the floor that can be reached from the start, at least
_REACH = 1.5  # [m] clearances above it count alike
_ATTEMPTS = 200


def solvable(
    draw: Callable[[np.random.Generator, float, Size], Shapes],
    rng: np.random.Generator,
    difficulty: float,
    size: Size,
    widest: float = math.inf,
) -> World:
    """The first world that `draw` draws in which a robot gets from its start to a good part of the floor.

    The start is the place farthest from all walls, the goal the one with the longest way from there. At least `FREE` of
    the floor can be reached by passages as wide as the difficulty allows.

    Args:
        draw: From a source of random numbers, a difficulty and a size to boxes and posts, without a wall around.
        rng: Where its random numbers come from.
        difficulty: From 0 to 1.
        size: Of the floor [m].
        widest: The widest passage that the way may need [m], if the floor is too small for what the difficulty says.

    Raises:
        InputError: If no such world is found.
    """
    passage = min(NARROW * (2.0 - difficulty), widest)
    for _ in range(_ATTEMPTS):
        world = _enclosed(*draw(rng, difficulty, size), size)
        floor = Floor.of(world, _REACH)
        row, column = divmod(int(floor.clearance.argmax()), floor.clearance.shape[1])
        # Half a square less than half the passage: no middle of a square need be in the middle of a door.
        steps = floor.steps_from(*floor.centre(row, column), passage / 2 - SIDE / 2)
        if (steps >= 0).sum() * SIDE**2 >= FREE * size[0] * size[1]:
            far = divmod(int(steps.argmax()), steps.shape[1])
            start, goal = floor.centre(row, column), floor.centre(*far)
            return replace(world, start=(*start, rng.uniform(-math.pi, math.pi)), goal=(*goal, 0.0))
    raise InputError(
        f"generator {draw.__module__.rpartition('.')[2]}: in {_ATTEMPTS} worlds of {size[0]:g} x {size[1]:g} m with "
        f"difficulty {difficulty:.2f} a robot gets to less than a third of the floor; "
        "try another difficulty, or a larger size"
    )


def _enclosed(boxes: Sequence[BoxShape], posts: Sequence[PostShape], size: Size) -> World:
    """A world with a wall around its floor; its start is to be found yet."""
    (x, y), t = size, THICKNESS
    around = [
        (x / 2, -t / 2, x + 2 * t, t, 0.0),
        (x / 2, y + t / 2, x + 2 * t, t, 0.0),
        (-t / 2, y / 2, t, y, 0.0),
        (x + t / 2, y / 2, t, y, 0.0),
    ]
    return World.from_shapes("", [*around, *boxes], posts, start=(0.0, 0.0, 0.0), bounds=(-t, -t, x + t, y + t))
