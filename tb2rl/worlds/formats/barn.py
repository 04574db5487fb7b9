"""The worlds of the BARN challenge (Perille et al. 2020, "Benchmarking Metric Ground Navigation").

Posts on a grid stand in a yard that is closed by posts on three sides. A robot starts in its closed half, and its goal
lies beyond the open end. A reference path leads through the posts.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.formats.sdf import read_sdf
from tb2rl.worlds.world import World

START, GOAL = (-2.25, 3.0, 1.57), (-2.25, 13.0, 1.57)  # x [m], y [m], yaw [rad]
# The yard is x from -4.5 to 0 m and y from 0 to 9.6 m. In the challenge the floor around it has no end. Here it is 2 m
# wide, enough to come out to the goal anywhere; a path around the yard leads nowhere.
BOUNDS = (-6.5, -2.0, 2.0, 15.0)
_STEP = 0.15  # [m] between a path's rows along x, and its columns along y
_FIRST = np.array([-4.425, 5.175])  # [m] x of the first row, y of the first column
_FOLDERS = ("", "jackal_helper/worlds/BARN", "worlds/BARN", "BARN")  # of a repository, where worlds may be


@dataclass(frozen=True)
class BarnWorld:
    """A world, and the length of its reference path with the ends to its start and its goal [m]."""

    world: World
    reference: float


def read_barn(path: Path) -> list[BarnWorld]:
    """Read the worlds of a file or a folder, sorted by their numbers.

    Args:
        path: An .npz file with `posts_N`, x, y and radius [m], shape (posts, 3), and `path_N`, row and column of the
            reference path, shape (steps, 2), for each number N; or a folder with `path_files/path_N.npy` and
            `world_N.world`, optionally in `world_files`: the data set, or a copy of the challenge's repository.

    Raises:
        InputError: If it does not contain such worlds.
    """
    is_folder = os.path.isdir(path)  # noqa: PTH112 (Path.is_dir raises for a name that is too long)
    found = dict(_in_folder(path) if is_folder else _in_archive(path))
    if not found:
        raise InputError(f"there are no worlds of BARN in {path}: no arrays posts_N and path_N for any number N")
    return [found[number] for number in sorted(found)]


def _in_archive(path: Path) -> Iterator[tuple[int, BarnWorld]]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = dict(archive)
    except Exception as error:  # any error that a broken file causes
        raise InputError(one_line(f"{path} is not an .npz file of worlds: {error}")) from None
    for name in arrays:
        if (match := re.fullmatch(r"posts_(\d{1,6})", name)) is None:
            continue
        number = int(match[1])
        if f"path_{match[1]}" not in arrays:
            raise InputError(f"{path}: there is {name}, but no path_{match[1]}")
        posts = _table(arrays[name], 3, f"{path}: {name}")
        world = World.from_shapes(f"barn {number}", posts=posts.tolist(), start=START, goal=GOAL, bounds=BOUNDS)
        yield number, BarnWorld(world, _reference(arrays[f"path_{match[1]}"], f"{path}: path_{match[1]}"))


def _in_folder(path: Path) -> Iterator[tuple[int, BarnWorld]]:
    folder = next((path / name for name in _FOLDERS if (path / name / "path_files").is_dir()), None)
    if folder is None:
        raise InputError(f"{path} holds no worlds of BARN: there is no folder path_files in it, with their paths")
    options = ImportOptions(start=START, goal=GOAL, bounds=BOUNDS)
    for file in (*folder.glob("world_*.world"), *folder.glob("world_files/world_*.world")):
        if (match := re.fullmatch(r"world_(\d{1,6})", file.stem)) is None:
            continue
        reference = folder / "path_files" / f"path_{match[1]}.npy"
        try:
            cells = np.load(reference, allow_pickle=False)
        except Exception as error:  # any error that a broken file causes
            raise InputError(one_line(f"cannot read {reference}: {error}")) from None
        world = replace(read_sdf(file, options), name=f"barn {int(match[1])}")
        yield int(match[1]), BarnWorld(world, _reference(cells, str(reference)))


def _reference(cells: np.ndarray, where: str) -> float:
    """Length from the start over the path's rows and columns, shape (steps, 2), to the goal [m]."""
    places = _FIRST + _STEP * _table(cells, 2, where)
    path = np.concatenate([[START[:2]], places, [GOAL[:2]]])
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def _table(values: object, columns: int, where: str) -> np.ndarray:
    """Check a table of numbers."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != columns or len(array) == 0 or array.dtype.kind not in "iuf":
        raise InputError(f"{where} must be rows of {columns} numbers, but is {array.dtype} of shape {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{where} has a number that is NaN or infinite")
    return array.astype(float)
