"""What the tests of several rooms need: setups of named worlds, readings by hand, a suite, a user who may not write."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tb2rl.commands import suite as suite_command
from tb2rl.registry import find_world
from tb2rl.robots import Robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import Reading, Setup, Start
from tb2rl.worlds import World
from tb2rl.worlds.suites import Suite

FLOOR = World.from_shapes("floor", start=(0.0, 0.0, 0.0), bounds=(-9.0, -9.0, 9.0, 9.0))


def _setup(*worlds: World | str, robot: Robot = ROBOT, **laser) -> Setup:
    """The robot in some worlds (an open floor if none is given); `laser` changes fields of its laser."""
    found = tuple(find_world(world) if isinstance(world, str) else world for world in worlds)
    return Setup(robot, replace(robot.laser, **laser), found or (FLOOR,))


def _reading(
    nearest=3.0,
    ranges=None,
    bumped=False,
    pose=(0.0, 0.0, 0.0),
    odometry=None,
    twist=(0.0, 0.0),
    goal=(math.nan, math.nan),
    bounds=(-9.0, -9.0, 9.0, 9.0),
    **others,
) -> Reading:
    """A reading of as many robots as the longest argument has; a single value is the same for all.

    `others` are further fields of the reading, at rest if they are left out.
    `ranges` are (robots, beams) or (beams,); without them each robot has three beams, the middle one of `nearest` [m].
    """
    pose, twist = np.atleast_2d(np.array(pose, float)), np.atleast_2d(np.array(twist, float))
    ranges = None if ranges is None else np.atleast_2d(np.array(ranges, float))
    robots = max(len(pose), len(twist), np.size(nearest), np.size(bumped), 0 if ranges is None else len(ranges))
    if ranges is None:
        ranges = np.full((robots, 3), math.inf)
        ranges[:, 1] = nearest
    start = Start.proposed(_setup(), robots)
    start.goal[:], start.bounds[:] = goal, bounds
    pose = np.broadcast_to(pose, (robots, 3))
    twist = np.broadcast_to(twist, (robots, 2))
    at_rest = {"odometry_twist": twist, "command": np.zeros((robots, 2)), "acceleration": np.zeros(robots)}
    return Reading(
        pose=pose,
        twist=twist,
        odometry=pose if odometry is None else np.broadcast_to(np.array(odometry, float), (robots, 3)),
        ranges=np.broadcast_to(ranges, (robots, ranges.shape[1])),
        bumped=np.broadcast_to(np.array(bumped), robots),
        start=start,
        **(at_rest | others),
    )


def _small_suite(name: str = "unseen", last: float = 1.0) -> Suite:
    """Three worlds of two families, the last of which can be another; nobody reaches a goal within the time."""
    bounds, walls = (-4.0, -4.0, 4.0, 4.0), [(0.0, 3.5, 6.0, 0.2, 0.0)]
    worlds = tuple(
        World.from_shapes(f"at {y:g}", walls, start=(-2.0, y, 0.0), goal=(0.0, y, 0.0), bounds=bounds)
        for y in (-1.0, 0.0, last)
    )
    return Suite(name, worlds, ("a", "b", "a"), (2.0, 2.0, 2.0), 1.0)


@pytest.fixture
def make_setup():
    """The function `_setup`."""
    return _setup


@pytest.fixture
def make_reading():
    """The function `_reading`."""
    return _reading


@pytest.fixture
def small_suite():
    """The function `_small_suite`."""
    return _small_suite


@pytest.fixture
def driven(monkeypatch) -> list[int]:
    """The worlds of suites that were driven, as they come."""
    drives_of, driven = suite_command.drives_of, []

    def noted(*arguments):
        for drive in drives_of(*arguments):
            driven.append(drive.world)
            yield drive

    monkeypatch.setattr(suite_command, "drives_of", noted)
    return driven


@pytest.fixture
def write_package(tmp_path, monkeypatch):
    """A function that writes a package as pip leaves it in site-packages: its entry points, and modules by name."""

    def write(entry_points: str, **modules: str) -> None:
        info = tmp_path / "stranger-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entry_points)
        for name, code in modules.items():
            (tmp_path / f"{name}.py").write_text(code)
        monkeypatch.syspath_prepend(tmp_path)

    return write


_NOBODY = 65534


class Guest:
    """A user who may read everything and write next to nothing, as in the image of a container.

    Root takes another user for it, who may still read what root may: Python can stand in root's home.
    """

    def __init__(self, folder: Path) -> None:
        self.is_root, self._locked = os.geteuid() == 0, list[Path]()
        self.scratch = self.own(folder)

    def own(self, folder: Path) -> Path:
        """A new folder that this user may write to."""
        folder.mkdir()
        if self.is_root:
            os.chown(folder, _NOBODY, _NOBODY)
        return folder

    def lock(self, folder: Path) -> None:
        """Let this user write nowhere in a folder until the test is over."""
        for place in (folder, *folder.rglob("*/")):
            if place.is_dir() and not place.is_symlink():
                self._locked.append(place)
                place.chmod(0o555)

    def unlock(self) -> None:
        """Undo it, so that the folders can be removed."""
        for place in self._locked:
            place.chmod(0o755)

    def run(self, command: Sequence[str], **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a command as this user: with a home that cannot be, and `scratch` for temporary files."""
        reading = ["--inh-caps", "+dac_read_search", "--ambient-caps", "+dac_read_search"]
        user = ["setpriv", f"--reuid={_NOBODY}", f"--regid={_NOBODY}", "--clear-groups", *reading]
        ours = ("NUMBA", "TB2RL", "XDG", "PYTEST")
        kept = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
        env = {**kept, "HOME": "/nonexistent", "TMPDIR": str(self.scratch), "PYTHONDONTWRITEBYTECODE": "1", **variables}
        words = [*(user if self.is_root else ()), *command]
        return subprocess.run(words, cwd=self.scratch, env=env, capture_output=True, text=True, check=False)


@pytest.fixture
def guest(tmp_path):
    """A `Guest`."""
    if os.name != "posix" or (os.geteuid() == 0 and not shutil.which("setpriv")):
        pytest.skip("there is no user here who may not write: that takes setpriv, or not to be root")
    user = Guest(tmp_path / "scratch")
    yield user
    user.unlock()
