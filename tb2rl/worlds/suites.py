"""Suites: worlds that navigators are compared in, each driven once, from its own start to its own goal.

`unseen` is generated and frozen, `barn` is read from files of the BARN challenge.
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
from tb2rl.worlds.generators import FAMILIES, GeneratorSettings, generate, world_rng
from tb2rl.worlds.goal_paths import shortest_path_length
from tb2rl.worlds.places import Places
from tb2rl.worlds.world import World

RADIUS = 0.178  # [m] of the robot that paths are computed for: TurtleBot2's
START_CLEARANCE, GOAL_CLEARANCE = 0.25, 0.3  # [m] of a start and a goal of `unseen`
MIN_PATH_LENGTH = 4.0  # [m] from a start of `unseen` to its goal
SUITES = ("unseen", "barn")
_UNSEEN = GeneratorSettings("mixed", worlds=1000, difficulty=(0.0, 1.0), seed=0, size=(8.0, 8.0))
_UNSEEN_TIME = 120.0  # [s] twice the time that the longest path takes at half speed
_PLACES = 1  # seed of starts and goals, beside that of the worlds themselves
_BARN_TIME, _BARN_RADIUS = 100.0, 1.0  # [s], [m] the rules of the challenge
_DIGITS = 6  # after the point that count in a digest


@dataclass(frozen=True, eq=False)
class Suite:
    """Worlds for an evaluation, each with a goal.

    Attributes:
        families: The family of each world.
        path_lengths: Length of the shortest path from start to goal in each [m], see `shortest_path_length`.
        time_limit: Of an episode [s].
        goal_radius: Distance at which the goal is reached [m]; None: the task's own.
        references: Length of the path that the BARN score refers to, in each [m]; None: there is no such score.
        path: Where the worlds were read from; None: they are generated.
    """

    name: str
    worlds: tuple[World, ...]
    families: tuple[str, ...]
    path_lengths: tuple[float, ...]
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
    """The suite of a name; `path` is where the worlds of `barn` are.

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

    Start and goal are drawn until the path between them is at least `MIN_PATH_LENGTH` long. The suite is frozen, so
    that results stay comparable: a change of its worlds needs another name.
    """
    generated = generate(_UNSEEN, FAMILIES, "suite")
    worlds, lengths = zip(*map(_with_random_places, generated, range(len(generated))), strict=True)
    families = tuple(FAMILIES[number % len(FAMILIES)].__name__ for number in range(len(worlds)))
    return Suite("unseen", worlds, families, lengths, _UNSEEN_TIME)


def barn(path: Path) -> Suite:
    """Worlds of the BARN challenge, by its rules: within 1 m of the goal after 100 s at most, without a collision.

    There are two differences. The 100 s count from the beginning, in the challenge from the first 0.1 m of motion. And
    a robot that plans knows the bounds of the world (`tb2rl.worlds.formats.barn`), which the challenge does not have.

    Args:
        path: An .npz file, or a copy of the challenge's repository, see `read_barn`.

    Raises:
        InputError: If it does not contain such worlds, or one has no path from start to goal.
    """
    found = read_barn(path)
    worlds = tuple(each.world for each in found)
    lengths = tuple(shortest_path_length(world, RADIUS) for world in worlds)
    for world, length in zip(worlds, lengths, strict=True):
        if not math.isfinite(length):
            raise InputError(f"{path}: world {world.name} has no path from its start to its goal")
    references = tuple(each.reference for each in found)
    return Suite("barn", worlds, ("barn",) * len(worlds), lengths, _BARN_TIME, _BARN_RADIUS, references, path)


def _with_random_places(world: World, number: int) -> tuple[World, float]:
    """The world with a random start and goal, and the length of the path between them [m]."""
    rng, places = world_rng("suite", _PLACES, number), Places((world,), RADIUS)

    def draw(clearance: float) -> tuple[float, float, float]:
        x, y, yaw = places.poses_from(np.zeros(1, dtype=int), rng.random((1, 4)), clearance)[0].tolist()
        return x, y, yaw

    while True:  # ends, because a third of the floor can be reached
        placed = replace(world, start=draw(START_CLEARANCE), goal=draw(GOAL_CLEARANCE))
        length = shortest_path_length(placed, RADIUS)
        if MIN_PATH_LENGTH <= length < math.inf:
            return placed, length


def _bytes(values: Iterable[float] | np.ndarray | None) -> bytes:
    """Shape and rounded numbers as bytes."""
    numbers = np.round(np.asarray(values, dtype=float), _DIGITS) + 0.0  # no -0
    return repr(numbers.shape).encode() + numbers.astype("<f8").tobytes()
