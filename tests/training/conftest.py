"""Trainings of a few steps, what a killed one leaves behind, and tasks in a module of a user's own."""

import json
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run

MY_TASKS = """
    from dataclasses import dataclass

    import numpy as np

    from tb2rl.sensors import Sensor
    from tb2rl.tasks.wander import Wander

    class Picture(Sensor):
        name, shape = "picture", (1, 36, 36)

        def read(self, robot_state):
            rows = np.arange(36)[:, None] < 12 * np.minimum(robot_state.ranges, 3.0)[:, None, :]
            return (255 * rows[:, None]).astype(np.uint8)

    @dataclass(frozen=True)
    class Pictured(Wander):
        "An image beside the laser's ranges."
        def sensors(self, spec):
            return (*super().sensors(spec), Picture())

    @dataclass(frozen=True)
    class OnlyPicture(Wander):
        "An image alone."
        def sensors(self, spec):
            return (Picture(),)
    """


@pytest.fixture(scope="session", autouse=True)
def my_tasks(tmp_path_factory) -> Iterator[None]:
    """The importable module `my_tasks`."""
    folder = tmp_path_factory.mktemp("modules")
    (folder / "my_tasks.py").write_text(dedent(MY_TASKS))
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


def _differences(one: Any, other: Any, path: str = "") -> Iterator[str]:
    """The places where two trees differ by a bit, except in elapsed time."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        if one.keys() != other.keys():
            yield f"{path}: {sorted(one.keys() ^ other.keys())}"
        for key in one.keys() & other.keys() - {"elapsed"}:
            yield from _differences(one[key], other[key], f"{path}/{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from _differences(a, b, f"{path}/{i}")
    elif isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if (one.dtype, one.shape, one.tobytes()) != (other.dtype, other.shape, other.tobytes()):
            yield path
    elif one != other:
        yield f"{path}: {one!r}, {other!r}"


def _evaluations(run: Run) -> list[dict[str, Any]]:
    """The evaluations during a training, without the time that they took."""
    file = run.folder / "evaluations.jsonl"
    lines = map(json.loads, file.read_text().splitlines() if file.exists() else ())
    return [{key: value for key, value in line.items() if key not in {"seconds", "elapsed"}} for line in lines]


@pytest.fixture(scope="session")
def assert_same_runs():
    """Asserts that two runs have the same last checkpoint, policy and evaluations, to the bit."""

    def compare(one: Run, other: Run) -> None:
        assert list(_differences(*(read_checkpoint(run.checkpoints[0]) for run in (one, other)))) == []
        assert list(_differences(*(read_checkpoint(run.policy_file) for run in (one, other)))) == []
        assert _evaluations(one) == _evaluations(other)

    return compare


@pytest.fixture(scope="session")
def evaluations():
    """The function `_evaluations`."""
    return _evaluations


@pytest.fixture(scope="session")
def killed():
    """Copies a run as `kill -9` leaves it after its first checkpoint, with some files from later on."""

    def copy(whole: Run, folder: Path) -> Run:
        shutil.copytree(whole.folder, folder)
        for file in Run.open(folder).checkpoints[:-1]:
            file.unlink()
        shutil.rmtree(folder / "final")
        return Run.open(folder)

    return copy


@pytest.fixture(scope="session")
def small():
    """Makes the config of a short kinematic training without evaluations and checkpoints, unless it asks for them."""

    def make(agent="qlearn", task="maze", settings=None, **train):
        short = {"simulation": "kinematic", "n_envs": 4, "total_timesteps": 128, "eval_freq": 0, "save_freq": 0}
        train = {**short, **train}
        return resolve(agent, task, settings={f"train.{key}": value for key, value in train.items()} | (settings or {}))

    return make


@pytest.fixture(scope="session")
def scalars():
    """Reads the steps and values of a curve in TensorBoard."""

    def read(run: Run, tag: str) -> list[tuple[int, float]]:
        events = EventAccumulator(str(run.folder / "tensorboard")).Reload()
        return [(event.step, event.value) for event in events.Scalars(tag)]

    return read
