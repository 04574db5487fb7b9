"""Studies of very short trainings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tb2rl.execution.local import LocalExecutor
from tb2rl.runs.layers import as_preset
from tb2rl.tuning.study import StudyFolder, StudyOptions

TINY = {
    "train.simulation": "kinematic", "train.n_envs": 8, "train.total_timesteps": 1024, "train.eval_freq": 256,
    "train.eval_episodes": 5, "train.eval_steps": 30, "train.stop_score": None,
}  # fmt: skip
SPACE = {"agent.gamma": {"low": 0.8, "high": 0.99}, "agent.averaging": {"choices": [None, 0.01, 0.1]}}


class InProcessExecutor(LocalExecutor):
    """Runs one job after the other in this process, where tests can replace functions."""

    def as_completed(self, function, jobs, shared=(), timeout=None):
        for job in jobs:
            yield job, function(*shared, *job.arguments, job.folder)


@pytest.fixture
def executor():
    """An `InProcessExecutor`."""
    with InProcessExecutor() as executor:
        yield executor


@pytest.fixture
def make_folder(tmp_path, monkeypatch):
    """A function that creates the folder of a study in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def make_folder(
        name: str = "it",
        space: Mapping[str, Any] | None = None,
        settings: Mapping[str, Any] | None = None,
        agent: str = "qlearn",
        **options: Any,
    ) -> StudyFolder:
        default = as_preset(agent, "maze", settings={**TINY, **(settings or {})})
        options = StudyOptions(dict(space or SPACE), **{"seeds": 1, **options})
        return StudyFolder.create(Path("runs", "tune", name), options, default)

    return make_folder


@pytest.fixture
def tiny() -> list[str]:
    """Settings of very short trainings for a command line."""
    return [f"{key}={'null' if value is None else value}" for key, value in TINY.items() if "simulation" not in key]
