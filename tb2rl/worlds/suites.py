"""Suites: worlds for comparisons of navigation policies, with one episode from start to goal in each world.

The suite `unseen` is generated and frozen; `barn` is read from files of the BARN challenge.
"""

import hashlib
import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from tb2rl.core.errors import InputError, unknown
from tb2rl.worlds.formats.barn import read_barn
from tb2rl.worlds.generators import FAMILIES, GeneratorSettings, generate, world_rng
from tb2rl.worlds.goal_paths import shortest_path_length
from tb2rl.worlds.pose_sampler import PoseSampler
from tb2rl.worlds.world import World

ROBOT_RADIUS = 0.178  # [m] radius of a TurtleBot2, for which the shortest paths are computed
START_CLEARANCE, GOAL_CLEARANCE = 0.25, 0.3  # [m] clearance of starts and goals in `unseen`
MIN_PATH_LENGTH = 4.0  # [m] minimum path length from start to goal in `unseen`
SUITES = ("unseen", "barn")
_UNSEEN = GeneratorSettings("mixed", worlds=1000, difficulty=(0.0, 1.0), seed=0, size=(8.0, 8.0))
_UNSEEN_TIME_LIMIT = 120.0  # [s] enough for the longest path at half the top speed
_START_AND_GOAL_SEED = 1  # another seed than that of the worlds
_BARN_TIME_LIMIT, _BARN_GOAL_RADIUS = 100.0, 1.0  # [s], [m] rules of the challenge


@dataclass(frozen=True, eq=False)
class Suite:
    """Worlds for an evaluation, each with a goal.

    Attributes:
        families: Family of each world, such as the name of its generator.
        path_lengths: Length of the shortest path from start to goal in each world [m], see `shortest_path_length`.
        time_limit: Time limit of an episode [s].
        goal_radius: Distance at which the goal is reached [m]; None: the goal radius of the task.
        references: Length of the reference path of the BARN score in each world [m]; None: a suite without this score.
        path: File or folder of the worlds; None: the worlds are generated.
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
        """SHA-256 of all obstacles, starts, goals and references, rounded to 1e-6."""
        digest = hashlib.sha256()
        tables = [table for world in self.worlds for table in (world.boxes, world.posts, world.start, world.goal)]
        for table in [*tables, self.references or ()]:
            numbers = np.round(np.asarray(table, dtype=float), 6) + 0.0  # no -0
            digest.update(repr(numbers.shape).encode() + numbers.astype("<f8").tobytes())
        return digest.hexdigest()


def find_suite(name: str, path: Path | None = None) -> Suite:
    """Find a suite by name; `path` is the file or folder of the suite `barn`.

    Raises:
        InputError: If there is no such suite, or its worlds cannot be read.
    """
    if name not in SUITES:
        raise unknown("suite", name, SUITES)
    if (name == "barn") != (path is not None):
        raise InputError("suite barn needs the path of its worlds, barn PATH; suite unseen takes no path")
    return unseen() if path is None else barn(path)


@lru_cache(maxsize=1)
def unseen() -> Suite:
    """1000 generated worlds of 8 x 8 m, 200 of each generator, with difficulties from 0 to 1; never used in training.

    Start and goal are random, with a path of at least `MIN_PATH_LENGTH` between them. The suite is frozen, so that
    results stay comparable. A suite of other worlds needs another name.
    """
    generated = generate(_UNSEEN, FAMILIES, "suite")
    worlds, lengths = zip(*map(_randomise_start_and_goal, generated, range(len(generated))), strict=True)
    families = tuple(FAMILIES[number % len(FAMILIES)].__name__ for number in range(len(worlds)))
    return Suite("unseen", worlds, families, lengths, _UNSEEN_TIME_LIMIT)


def barn(path: Path) -> Suite:
    """Worlds of the BARN challenge: a robot must get within 1 m of the goal in 100 s without a collision.

    There are two differences from the challenge. Time is measured from the start of the episode, instead of after the
    first 0.1 m of motion. The worlds have bounds (`tb2rl.worlds.formats.barn`), which limit the paths of planners.

    Raises:
        InputError: If the path contains no such worlds (see `read_barn`), or a world has no path from start to goal.
    """
    worlds, references = zip(*read_barn(path), strict=True)
    lengths = tuple(shortest_path_length(world, ROBOT_RADIUS) for world in worlds)
    for world, length in zip(worlds, lengths, strict=True):
        if not math.isfinite(length):
            raise InputError(f"{path}: world {world.name} has no path from its start to its goal")
    families, limits = ("barn",) * len(worlds), (_BARN_TIME_LIMIT, _BARN_GOAL_RADIUS)
    return Suite("barn", worlds, families, lengths, *limits, references, path)


def _randomise_start_and_goal(world: World, number: int) -> tuple[World, float]:
    """Draw a random start and goal; return the new world and its path length [m]."""
    rng, sampler = world_rng("suite", _START_AND_GOAL_SEED, number), PoseSampler((world,), ROBOT_RADIUS)

    def draw(clearance: float) -> tuple[float, float, float]:
        x, y, yaw = sampler.sample_poses(np.zeros(1, dtype=int), rng.random((1, 4)), clearance)[0].tolist()
        return x, y, yaw

    while True:  # terminates, because a third of the floor is reachable
        candidate = replace(world, start=draw(START_CLEARANCE), goal=draw(GOAL_CLEARANCE))
        length = shortest_path_length(candidate, ROBOT_RADIUS)
        if MIN_PATH_LENGTH <= length < math.inf:
            return candidate, length
