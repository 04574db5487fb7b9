"""Reader of the BARN worlds (Perille et al. 2020, "Benchmarking Metric Ground Navigation").

A world is a yard with posts on a grid, and with walls of posts on three sides. A robot starts near the closed end. The
goal is beyond the open end. A reference path leads through the posts.
"""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.formats.sdf import read_sdf
from tb2rl.worlds.world import World

START, GOAL = (-2.25, 3.0, 1.57), (-2.25, 13.0, 1.57)  # x [m], y [m], yaw [rad]
# The yard has x from -4.5 to 0 m and y from 0 to 9.6 m. The floor around it is infinite in the challenge, but 2 m wide
# here, which suffices for all paths from the open end to the goal.
BOUNDS = (-6.5, -2.0, 2.0, 15.0)
_PATH_CELL = 0.15  # [m] distance between rows of a reference path (along x) and between columns (along y)
_PATH_ORIGIN = np.array([-4.425, 5.175])  # [m] x of row 0, y of column 0
_FOLDERS = ("", "jackal_helper/worlds/BARN", "worlds/BARN", "BARN")  # possible folders of the worlds in a repository


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
        raise InputError(f"there are no worlds of BARN in {path}: no arrays posts_N and path_N for any number N")
    return [found[number] for number in sorted(found)]


def _read_archive(path: Path) -> Iterator[tuple[int, tuple[World, float]]]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        for number in _world_numbers(archive, r"posts_(\d{1,6})"):
            posts = archive[f"posts_{number}"].tolist()
            world = World.from_shapes(f"barn {number}", posts=posts, start=START, goal=GOAL, bounds=BOUNDS)
            yield number, (world, _reference_length(archive[f"path_{number}"]))


def _read_folder(path: Path) -> Iterator[tuple[int, tuple[World, float]]]:
    folder = next((path / name for name in _FOLDERS if (path / name / "path_files").is_dir()), None)
    if folder is None:
        raise InputError("there is no folder path_files with reference paths")
    options = ImportOptions(start=START, goal=GOAL, bounds=BOUNDS)
    files = {file.name: file for file in (*folder.glob("world_*"), *folder.glob("world_files/world_*"))}
    for number in _world_numbers(files, r"world_(\d{1,6})\.world"):
        world = replace(read_sdf(files[f"world_{number}.world"], options), name=f"barn {number}")
        yield number, (world, _reference_length(np.load(folder / f"path_files/path_{number}.npy", allow_pickle=False)))


def _world_numbers(names: Iterable[str], pattern: str) -> list[int]:
    return [int(match[1]) for name in names if (match := re.fullmatch(pattern, name))]


def _reference_length(cells: np.ndarray) -> float:
    """Length of a path from the start through cells (row and column), shape (steps, 2), to the goal [m]."""
    path = np.concatenate([[START[:2]], _PATH_ORIGIN + _PATH_CELL * cells, [GOAL[:2]]])
    length = float(np.hypot(*np.diff(path, axis=0).T).sum())
    if not math.isfinite(length):
        raise InputError("a reference path has a NaN or infinite value")
    return length
