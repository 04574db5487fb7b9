"""Studies of very short trainings, and commands in processes of their own."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from tb2rl.execution.local import LocalExecutor
from tb2rl.runs.config import as_preset
from tb2rl.tuning import training
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.study import StudyFolder, StudyOptions
from tb2rl.tuning.training import TrainingResult

CHECKOUT = Path(__file__).parents[2]
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
def make_folder(workdir):
    """A function that creates the folder of a study in an empty folder."""

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
def untrained(monkeypatch):
    """The parameters of trials whose trainings take no time, and whose score is 0.25 or what they search."""
    trained = []

    def train(_, trial, path):
        trained.append(trial.params)
        trial.report(0.5, 1)
        return [TrainingResult(trial.params.get("agent.gamma", 0.25), 1.0, 1.0)]

    monkeypatch.setattr(training, "_train", train)
    return trained


@pytest.fixture
def tiny() -> list[str]:
    """Settings of very short trainings for a command line."""
    return [f"{key}={'null' if value is None else value}" for key, value in TINY.items() if "simulation" not in key]


@pytest.fixture
def start_tune(workdir):
    """A function that starts the command in a process."""

    def start(*arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "tb2rl.tune", *arguments]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(CHECKOUT)}, **pipes)

    return start


@pytest.fixture
def read_study():
    """A function that reads a study's folder, and its trials."""

    def read(path: Path) -> tuple[StudyFolder, list]:
        folder = StudyFolder(path, StudyOptions(**yaml.safe_load((path / "study.yaml").read_text())))
        with open_study(folder) as study:
            return folder, study.trials

    return read
