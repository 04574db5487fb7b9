"""Trainings of a few steps, what is left of a killed one, and tasks in a module of a user's own."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve

MY_TASKS = """
    from dataclasses import dataclass

    import numpy as np

    from tb2rl.sensors import Sensor
    from tb2rl.tasks import Outcome, Task, Velocities
    from tb2rl.tasks.wander import Wander

    class Picture(Sensor):
        name, shape = "picture", (1, 36, 36)

        def read(self, reading):
            rows = np.arange(36)[:, None] < 12 * np.minimum(reading.ranges, 3.0)[:, None, :]
            return (255 * rows[:, None]).astype(np.uint8)

    @dataclass(frozen=True)
    class Glide(Task):
        "Any speeds within a range."
        actions = Velocities(forward=(-0.1, 0.5), turn=(-1.0, 1.0))

        def outcome(self, before, action, after):
            crashed = after.bumped | (after.nearest < 0.5)
            return Outcome(np.where(crashed, -10.0, after.twist[:, 0]), failed={"collision": crashed})

    @dataclass(frozen=True)
    class Pictured(Wander):
        "An image beside the laser's ranges."
        def sensors(self, setup):
            return (*super().sensors(setup), Picture())

    @dataclass(frozen=True)
    class OnlyPicture(Wander):
        "An image alone."
        def sensors(self, setup):
            return (Picture(),)
    """
TIMED = {"elapsed"}  # what a clock says


@pytest.fixture(scope="session", autouse=True)
def my_tasks(tmp_path_factory) -> Iterator[None]:
    """The tasks "my_tasks:Glide" and "my_tasks:Pictured", in a module that Python finds."""
    folder = tmp_path_factory.mktemp("modules")
    (folder / "my_tasks.py").write_text(dedent(MY_TASKS))
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


def _differences(one: Any, other: Any, path: str = "") -> Iterator[str]:
    """Where two trees differ, to the bit."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        if one.keys() != other.keys():
            yield f"{path}: {sorted(one.keys() ^ other.keys())}"
        for key in one.keys() & other.keys() - TIMED:
            yield from _differences(one[key], other[key], f"{path}/{key}")
    elif isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            yield f"{path}: lengths {len(one)}, {len(other)}"
        for i, (a, b) in enumerate(zip(one, other, strict=False)):
            yield from _differences(a, b, f"{path}/{i}")
    elif isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.dtype != other.dtype or one.shape != other.shape or one.tobytes() != other.tobytes():
            yield path
    elif one != other:
        yield f"{path}: {one!r}, {other!r}"


def _killed(whole: Run, folder: Path) -> Run:
    """What `kill -9` leaves after the first checkpoint of a run, some of what came later included."""
    shutil.copytree(whole.folder, folder)
    for file in Run.open(folder).checkpoints[:-1]:
        file.unlink()
    shutil.rmtree(folder / "final")
    return Run.open(folder)


def _config(agent="qlearn", task="maze", settings=None, **train):
    """A training in the twin without evaluations and checkpoints on the way, unless `train` says otherwise."""
    train = {"simulation": "kinematic", "n_envs": 4, "total_timesteps": 128, "eval_freq": 0, "save_freq": 0, **train}
    return resolve(agent, task, settings={f"train.{key}": value for key, value in train.items()} | (settings or {}))


def _scalars(run: Run, tag: str) -> list[tuple[int, float]]:
    """The steps and values of a curve in TensorBoard."""
    events = EventAccumulator(str(run.folder / "tensorboard")).Reload()
    return [(event.step, event.value) for event in events.Scalars(tag)]


@pytest.fixture
def differences():
    """A function from two trees to a list of the places where they differ, to the bit."""
    return lambda one, other: list(_differences(one, other))


@pytest.fixture
def killed():
    """The function `_killed`."""
    return _killed


@pytest.fixture(scope="session")
def small():
    """The function `_config`."""
    return _config


@pytest.fixture
def scalars():
    """The function `_scalars`."""
    return _scalars
