"""Suites: worlds that policies are compared in, each driven once, from its own start to its own goal.

`unseen` is made here and frozen, `barn` is read from files of the BARN challenge.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from tb2rl.core.errors import InputError, unknown
from tb2rl.worlds.formats.barn import read_barn
from tb2rl.worlds.generators import FAMILIES, Generated, generate, generator_of
from tb2rl.worlds.goal_paths import shortest_path_length
from tb2rl.worlds.places import Places
from tb2rl.worlds.world import World

RADIUS = 0.178  # [m] of the robot that ways are measured for: TurtleBot2's
START_CLEARANCE, GOAL_CLEARANCE = 0.25, 0.3  # [m] of a start and a goal of `unseen`
LEAST_WAY = 4.0  # [m] from a start of `unseen` to its goal
SUITES = ("unseen", "barn")
_UNSEEN = Generated("mixed", worlds=1000, difficulty=(0.0, 1.0), seed=0, size=(8.0, 8.0))
_UNSEEN_TIME = 120.0  # [s] twice what the longest way takes at half speed
_PLACES = 1  # seed of starts and goals, beside that of the worlds themselves
_BARN_TIME, _BARN_RADIUS = 100.0, 1.0  # [s], [m] the rules of the challenge
_ROUNDED = 6  # digits after the point that count


@dataclass(frozen=True, eq=False)
class Suite:
    """Worlds to be judged in.

    Attributes:
        name: What it is called.
        worlds: Each with a goal, too.
        families: What kind each world is of.
        ways: How long the shortest way from start to goal is in each [m], see `shortest_path_length`.
        time_limit: Of an episode [s].
        goal_radius: How near to the goal is there [m]; None: the task says it.
        references: Length of the way that the score of BARN goes by, in each [m]; None: there is no such score.
        path: Where the worlds were read from; None: they are made.
    """

    name: str
    worlds: tuple[World, ...]
    families: tuple[str, ...]
    ways: tuple[float, ...]
    time_limit: float
    goal_radius: float | None = None
    references: tuple[float, ...] | None = None
    path: Path | None = None

    @cached_property
    def digest(self) -> str:
        """SHA-256 over all obstacles, starts, goals and references, to a thousandth of a millimetre."""
        digest = hashlib.sha256()
        for world in self.worlds:
            for values in (world.boxes, world.posts, world.start, world.goal):
                digest.update(_bytes(values))
        digest.update(_bytes(self.references or ()))
        return digest.hexdigest()


def find_suite(name: str, path: Path | None = None) -> Suite:
    """The suite of a name; `path` is where its worlds are, if they are not made here.

    Raises:
        InputError: If there is no such suite, or its worlds cannot be read.
    """
    if name not in SUITES:
        raise unknown("suite", name, SUITES)
    if (name == "barn") != (path is not None):
        raise InputError("suite barn needs the path of its worlds, barn PATH; suite unseen takes none")
    return unseen() if path is None else barn(path)


@lru_cache(maxsize=1)
def unseen() -> Suite:
    """A thousand worlds of 8 x 8 m that nothing else draws, 200 of each generator, with difficulties from 0 to 1.

    Start and goal are drawn anew until the way from one to the other is at least `LEAST_WAY` long. The suite is frozen,
    so that results can be compared: who changes what it is made of gives it another name.
    """
    generated = generate(_UNSEEN, FAMILIES, "suite")
    worlds, ways = zip(*map(_placed, generated, range(len(generated))), strict=True)
    families = tuple(FAMILIES[number % len(FAMILIES)].__name__ for number in range(len(worlds)))
    return Suite("unseen", worlds, families, ways, _UNSEEN_TIME)


def barn(path: Path) -> Suite:
    """Worlds of the BARN challenge, by its rules: within 1 m of the goal after 100 s at most, and no touch.

    Two things differ. The 100 s count from the beginning, and there from 0.1 m of motion on. And a robot that plans
    knows the rectangle that counts as the world (`tb2rl.worlds.formats.barn`), which there has no end.

    Args:
        path: An .npz file, or a copy of the challenge's repository, see `read_barn`.

    Raises:
        InputError: If it does not hold such worlds, or one has no way from start to goal.
    """
    found = read_barn(path)
    worlds = tuple(each.world for each in found)
    ways = tuple(shortest_path_length(world, RADIUS) for world in worlds)
    for world, way in zip(worlds, ways, strict=True):
        if not math.isfinite(way):
            raise InputError(f"{path}: world {world.name} has no way from its start to its goal")
    references = tuple(each.reference for each in found)
    return Suite("barn", worlds, ("barn",) * len(worlds), ways, _BARN_TIME, _BARN_RADIUS, references, path)


def _placed(world: World, number: int) -> tuple[World, float]:
    """The world with a start and a goal that are drawn for it, and the way between them [m]."""
    rng, places = generator_of("suite", _PLACES, number), Places((world,), RADIUS)

    def draw(clearance: float) -> tuple[float, float, float]:
        x, y, yaw = places.poses_from(np.zeros(1, dtype=int), rng.random((1, 4)), clearance)[0].tolist()
        return x, y, yaw

    while True:  # where a third of the floor can be reached, there is always such a way
        placed = replace(world, start=draw(START_CLEARANCE), goal=draw(GOAL_CLEARANCE))
        way = shortest_path_length(placed, RADIUS)
        if LEAST_WAY <= way < math.inf:
            return placed, way


def _bytes(values: Iterable[float] | np.ndarray | None) -> bytes:
    """Numbers as bytes that are the same wherever they round to the same, with how many there are."""
    numbers = np.round(np.asarray(values, dtype=float), _ROUNDED) + 0.0  # no -0
    return repr(numbers.shape).encode() + numbers.astype("<f8").tobytes()
