"""Generated worlds, reproducible in every process.

The random numbers of a world depend only on its purpose, the seed of the generator, and its number. So the worlds of
training, validation, test, hyperparameter search and suites never coincide.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Le

from tb2rl.core.errors import InputError
from tb2rl.core.values import ASCENDING, MAX_WORLDS, PAIR, Fraction
from tb2rl.worlds.floor import CELL_SIZE, Floor
from tb2rl.worlds.world import BoxShape, PostShape, World

Size = tuple[float, float]  # size of the floor in x and y [m]; the origin is the lower left corner
Shapes = tuple[Sequence[BoxShape], Sequence[PostShape]]
ShapeMaker = Callable[[np.random.Generator, float, Size], Shapes]  # function of rng, difficulty and size
WorldMaker = Callable[[np.random.Generator, float, Size], World]
Purpose = Literal["training", "validation", "test", "suite", "search"]  # its index is part of the seed
Side = Annotated[float, Ge(4), Le(100)]

WALL_THICKNESS = 0.1  # [m] thickness of the outer wall
MIN_PASSAGE = 0.5  # [m] minimum width of passages at difficulty 1; it is double at difficulty 0
MIN_REACHABLE = 1 / 3  # share of the floor that is reachable from the start
_MAX_CLEARANCE = 1.5  # [m] clearances of candidate starts are clipped at this value
_ATTEMPTS = 200  # number of worlds that `solvable` draws before it raises an error


@dataclass(frozen=True)
class GeneratorSettings:
    """Settings of a generator in `task.world`."""

    generator: str  # name of a generator, or "module:function"
    worlds: Annotated[int, Ge(1), Le(MAX_WORLDS)] = 512  # number of worlds for each purpose
    difficulty: Annotated[tuple[Fraction, Fraction], PAIR, ASCENDING] = (0.0, 1.0)  # range of random difficulties
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0  # seed of the worlds
    size: tuple[Side, Side] = (8.0, 8.0)  # [m] size of the floor in x and y


def generate(settings: GeneratorSettings, makers: Sequence[WorldMaker], purpose: Purpose) -> tuple[World, ...]:
    """Generate worlds by several makers in turns.

    Raises:
        InputError: If a maker finds no world, or returns another object than a `World`.
    """
    worlds = []
    for number in range(settings.worlds):
        maker, rng = makers[number % len(makers)], world_rng(purpose, settings.seed, number)
        world = maker(rng, rng.uniform(*settings.difficulty), settings.size)
        if not isinstance(world, World):
            raise InputError(f"generator {settings.generator} returned {type(world).__name__}, not tb2rl.worlds.World")
        worlds.append(replace(world, name=f"{maker.__name__} {number} ({purpose})"))
    return tuple(worlds)


def world_rng(purpose: Purpose, seed: int, number: int) -> np.random.Generator:
    """Random number generator of a world."""
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=(get_args(Purpose).index(purpose), seed, number)))


def solvable(
    draw: ShapeMaker, rng: np.random.Generator, difficulty: float, size: Size, max_passage: float = math.inf
) -> World:
    """Draw worlds until a robot can reach at least `MIN_REACHABLE` of the floor from the start.

    The start is the point farthest from all walls; distances above `_MAX_CLEARANCE` count as equal. The goal is the
    point with the longest path from the start. The difficulty determines the minimum width of the passages on it.

    Args:
        draw: Function of rng, difficulty (0 to 1) and size [m] that returns boxes and posts, without the outer wall.
        rng, difficulty, size: Arguments of `draw`.
        max_passage: Upper limit of the minimum width of passages [m], for small floors.

    Raises:
        InputError: If no such world is found.
    """
    passage = min(MIN_PASSAGE * (2.0 - difficulty), max_passage)
    (x, y), t = size, WALL_THICKNESS
    walls = [(x / 2, middle, x + 2 * t, t, 0.0) for middle in (-t / 2, y + t / 2)]
    walls += [(middle, y / 2, t, y, 0.0) for middle in (-t / 2, x + t / 2)]
    for _ in range(_ATTEMPTS):
        boxes, posts = draw(rng, difficulty, size)
        world = World.from_shapes("", [*walls, *boxes], posts, start=(0.0, 0.0, 0.0), bounds=(-t, -t, x + t, y + t))
        floor = Floor.of(world, _MAX_CLEARANCE)
        start = floor.centre(*divmod(int(floor.clearance.argmax()), floor.clearance.shape[1]))
        # Half a cell is subtracted, because the middle of a door is up to half a cell away from the nearest centre.
        steps = floor.steps_from(*start, passage / 2 - CELL_SIZE / 2)
        reachable = np.isfinite(steps)
        if reachable.sum() * CELL_SIZE**2 >= MIN_REACHABLE * x * y:
            goal = floor.centre(*divmod(int(np.where(reachable, steps, -1.0).argmax()), steps.shape[1]))
            return replace(world, start=(*start, rng.uniform(-math.pi, math.pi)), goal=(*goal, 0.0))
    name, attempts = draw.__module__.rpartition(".")[2], f"{_ATTEMPTS} worlds of {x:g} x {y:g} m"
    problem = f"with difficulty {difficulty:.2f} a robot reaches less than a third of the floor"
    raise InputError(f"generator {name}: in {attempts} {problem}; try another difficulty, or a larger size")


def family(draw: ShapeMaker) -> WorldMaker:
    """Decorator: turn a function that draws boxes and posts into a function that makes `solvable` worlds."""

    @wraps(draw)
    def make(rng: np.random.Generator, difficulty: float, size: Size) -> World:
        return solvable(draw, rng, difficulty, size)

    return make
