"""Suites: worlds for comparisons of navigation policies, with one episode from start to goal in each world.

The suites `unseen` and `unknown` are generated and frozen; `barn` is read from files of the BARN challenge.
"""

import hashlib
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.worlds.floor import PoseSampler
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.formats.sdf import read_sdf
from tb2rl.worlds.generators import FAMILIES, GeneratorSettings, WorldMaker, generate, offices, tunnels, world_rng
from tb2rl.worlds.goal_paths import shortest_path_length
from tb2rl.worlds.world import World

ROBOT_RADIUS = 0.178  # [m] radius of a TurtleBot2, for which the shortest paths are computed
START_CLEARANCE, GOAL_CLEARANCE = 0.25, 0.3  # [m] clearance of starts and goals in `unseen`
MIN_PATH_LENGTH = 4.0  # [m] minimum path length from start to goal in `unseen`
SUITES = ("unseen", "unknown", "barn")
_UNSEEN = GeneratorSettings("mixed", worlds=1000, difficulty=(0.0, 1.0), seed=0, size=(8.0, 8.0))
_UNKNOWN_SEED = 2  # unlike that of `unseen`
_UNSEEN_TIME_LIMIT = 120.0  # [s] enough for the longest path at half the top speed
_START_AND_GOAL_SEED = 1  # another seed than that of the worlds
_ATTEMPTS = 50  # draws of a start and a goal in a world
_NUM_UNKNOWN = 300  # worlds of `unknown`
# Its families in turns, each with the least and the largest side of a floor [m].
_UNKNOWN: tuple[tuple[WorldMaker, float, float], ...] = (
    (offices, 20.0, 40.0),
    (tunnels, 20.0, 30.0),
)
_MIN_UNKNOWN_PATH, _DETOUR = 15.0, 1.5  # [m] shortest path, and length of a third of the paths over the straight line
_PASSAGE = 0.5  # [m] width of all passages that a path needs, as in generated worlds at difficulty 1
_KNOWN_SPEED, _BUDGET = 0.55, 4.0  # [m/s] of a planner that knows the map, and the multiple of its time to be used
_BARN_TIME_LIMIT, _BARN_GOAL_RADIUS = 100.0, 1.0  # [s], [m] rules of the challenge
# Worlds of BARN (Perille et al. 2020, "Benchmarking Metric Ground Navigation"): a yard with posts on a grid, and with
# walls of posts on three sides. A robot starts near the closed end. The goal is beyond the open end.
_START, _GOAL = (-2.25, 3.0, 1.57), (-2.25, 13.0, 1.57)  # x [m], y [m], yaw [rad]
# The yard has x from -4.5 to 0 m and y from 0 to 9.6 m. The floor around it is infinite in the challenge, but 2 m wide
# here, which suffices for all paths from the open end to the goal.
_BOUNDS = (-6.5, -2.0, 2.0, 15.0)
_PATH_CELL = 0.15  # [m] distance between rows of a reference path (along x) and between columns (along y)
_PATH_ORIGIN = np.array([-4.425, 5.175])  # [m] x of row 0, y of column 0
_FOLDERS = ("", "jackal_helper/worlds/BARN", "worlds/BARN", "BARN")  # possible folders of the worlds in a repository


@dataclass(frozen=True, eq=False)
class Suite:
    """Worlds for an evaluation, each with a goal.

    Attributes:
        families: Family of each world, such as the name of its generator.
        path_lengths: Length of the shortest path from start to goal in each world [m], see `shortest_path_length`.
        time_limit: Time limit of an episode [s].
        time_limits: Time limits of the episodes [s], none above `time_limit`; None: `time_limit` for all.
        goal_radius: Distance at which the goal is reached [m]; None: the goal radius of the task.
        reference_lengths: Lengths of the reference paths of the BARN score [m], one per world; None: no such score.
        path: File or folder of the worlds; None: the worlds are generated.
    """

    name: str
    worlds: tuple[World, ...]
    families: tuple[str, ...]
    path_lengths: tuple[float, ...]
    time_limit: float
    goal_radius: float | None = None
    reference_lengths: tuple[float, ...] | None = None
    path: Path | None = None
    time_limits: tuple[float, ...] | None = None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all obstacles, starts, goals and reference lengths, rounded to 1e-6."""
        digest = hashlib.sha256()
        tables = [table for world in self.worlds for table in (world.boxes, world.posts, world.start, world.goal)]
        for table in [*tables, self.reference_lengths or ()]:
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
        raise InputError("suite barn needs the path of its worlds, barn PATH; other suites take no path")
    return barn(path) if path else unseen() if name == "unseen" else unknown_floors()


@lru_cache(maxsize=1)
def unseen() -> Suite:
    """1000 generated worlds of 8 x 8 m, 200 of each generator, with difficulties from 0 to 1; never used in training.

    Start and goal are random, with a path of at least `MIN_PATH_LENGTH` between them. The suite is frozen, so that
    results stay comparable. A suite of other worlds needs another name.
    """
    generated = generate(_UNSEEN, FAMILIES, "suite")
    found = [
        _draw_start_and_goal(each, world_rng("suite", _START_AND_GOAL_SEED, number))
        for number, each in enumerate(generated)
    ]
    worlds, lengths = zip(*filter(None, found), strict=True)
    families = tuple(FAMILIES[number % len(FAMILIES)].__name__ for number in range(len(worlds)))
    return Suite("unseen", worlds, families, lengths, _UNSEEN_TIME_LIMIT)


@lru_cache(maxsize=1)
def unknown_floors() -> Suite:
    """300 floors of offices and tunnels with sides of 20 to 40 m, for robots without a map; never used in training.

    Paths have at least 15 m. At least a third of them are at least 1.5 times as long as the straight line.
    A robot has four times the time that a planner with the map would need. The suite is frozen, as `unseen` is.
    """
    worlds, lengths = zip(*map(_draw_unknown_floor, range(_NUM_UNKNOWN)), strict=True)
    families = tuple(_UNKNOWN[number % len(_UNKNOWN)][0].__name__ for number in range(_NUM_UNKNOWN))
    limits = tuple(_BUDGET * length / _KNOWN_SPEED for length in lengths)
    return Suite("unknown", worlds, families, lengths, max(limits), time_limits=limits)


def barn(path: Path) -> Suite:
    """Worlds of the BARN challenge: a robot must get within 1 m of the goal in 100 s without a collision.

    There are two differences from the challenge. Time is measured from the start of the episode, instead of after the
    first 0.1 m of motion. The worlds have bounds (`_BOUNDS`), which limit the paths of planners.

    Raises:
        InputError: If the path contains no such worlds (see `read_barn`), or a world has no path from start to goal.
    """
    worlds, reference_lengths = zip(*read_barn(path), strict=True)
    lengths = tuple(shortest_path_length(world, ROBOT_RADIUS) for world in worlds)
    for world, length in zip(worlds, lengths, strict=True):
        if not math.isfinite(length):
            raise InputError(f"{path}: world {world.name} has no path from its start to its goal")
    families, limits = ("barn",) * len(worlds), (_BARN_TIME_LIMIT, _BARN_GOAL_RADIUS)
    return Suite("barn", worlds, families, lengths, *limits, reference_lengths, path)


def _draw_unknown_floor(number: int) -> tuple[World, float]:
    """Draw a floor of `unknown`; return it and its path length [m]."""
    maker, least, largest = _UNKNOWN[number % len(_UNKNOWN)]
    rng, detour = world_rng("suite", _UNKNOWN_SEED, number), _DETOUR if number // len(_UNKNOWN) % 3 == 0 else 0.0
    found = None
    while found is None:
        world = maker(rng, rng.random(), (rng.uniform(least, largest), rng.uniform(least, largest)))
        named = replace(world, name=f"{maker.__name__} {number} (unknown)")
        found = _draw_start_and_goal(named, rng, _PASSAGE / 2, _MIN_UNKNOWN_PATH, detour)
    return found


def _draw_start_and_goal(
    world: World,
    rng: np.random.Generator,
    radius: float = ROBOT_RADIUS,
    min_length: float = MIN_PATH_LENGTH,
    detour: float = 0.0,
) -> tuple[World, float] | None:
    """Draw a random start and goal; return the new world and its path length [m], or None if there are hardly any.

    A robot with this radius [m] can drive from one to the other. The path has at least `min_length` [m], and at least
    `detour` times the length of the straight line.
    """
    sampler = PoseSampler((world,), radius)

    def draw(clearance: float) -> tuple[float, float, float]:
        x, y, yaw = sampler.sample_poses(np.zeros(1, dtype=int), rng.random((1, 4)), clearance)[0].tolist()
        return x, y, yaw

    for _ in range(_ATTEMPTS):
        start, goal = draw(START_CLEARANCE), draw(GOAL_CLEARANCE)
        candidate = replace(world, start=start, goal=goal)
        length = shortest_path_length(candidate, radius)
        if max(min_length, detour * math.dist(start[:2], goal[:2])) <= length < math.inf:
            return candidate, length
    return None


def read_barn(path: Path) -> list[tuple[World, float]]:
    """Read the worlds of a file or a folder, sorted by number, with the lengths of their reference paths [m].

    Args:
        path: An .npz file with two arrays for each number N: `posts_N` has x, y and radius [m], shape (posts, 3), and
            `path_N` has rows and columns of the reference path, shape (steps, 2). Or the folder of the data set or of
            the challenge's repository, with `path_files/path_N.npy`, and `world_N.world` (or in `world_files`).

    Raises:
        InputError: If the path contains no such worlds.
    """
    try:
        found = dict(_read_folder(path) if path.is_dir() else _read_archive(path))
    except Exception as error:  # any error that a broken file causes
        raise InputError(one_line(f"cannot read worlds of BARN from {path}: {error}")) from None
    if not found:
        raise InputError(f"there are no worlds of BARN in {path}: neither arrays posts_N nor files world_N.world")
    return [found[number] for number in sorted(found)]


def _read_archive(path: Path) -> Iterator[tuple[int, tuple[World, float]]]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        for number in _world_numbers(archive, r"posts_(\d{1,6})"):
            posts = archive[f"posts_{number}"].tolist()
            world = World.from_shapes(f"barn {number}", posts=posts, start=_START, goal=_GOAL, bounds=_BOUNDS)
            yield number, (world, _reference_length(archive[f"path_{number}"]))


def _read_folder(path: Path) -> Iterator[tuple[int, tuple[World, float]]]:
    folder = next((path / name for name in _FOLDERS if (path / name / "path_files").is_dir()), None)
    if folder is None:
        raise InputError("there is no folder path_files with reference paths")
    options = ImportOptions(start=_START, goal=_GOAL, bounds=_BOUNDS)
    files = {file.name: file for file in (*folder.glob("world_*"), *folder.glob("world_files/world_*"))}
    for number in _world_numbers(files, r"world_(\d{1,6})\.world"):
        world = replace(read_sdf(files[f"world_{number}.world"], options), name=f"barn {number}")
        yield number, (world, _reference_length(np.load(folder / f"path_files/path_{number}.npy", allow_pickle=False)))


def _world_numbers(names: Iterable[str], pattern: str) -> list[int]:
    return [int(match[1]) for name in names if (match := re.fullmatch(pattern, name))]


def _reference_length(cells: np.ndarray) -> float:
    """Length of a path from the start through cells (row and column), shape (steps, 2), to the goal [m]."""
    path = np.concatenate([[_START[:2]], _PATH_ORIGIN + _PATH_CELL * cells, [_GOAL[:2]]])
    length = float(np.hypot(*np.diff(path, axis=0).T).sum())
    if not math.isfinite(length):
        raise InputError("a reference path has a NaN or infinite value")
    return length
