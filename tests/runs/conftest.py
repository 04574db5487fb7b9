"""Small runs of each learner that stopped after their first checkpoint, and helpers for files that do not fit."""

import shutil
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from tb2rl.core.errors import InputError
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run
from tb2rl.training.training import train_config

AGENTS = {
    "qlearn": {"task.range_bins": [0.7, 1.0]},
    "dqn": {
        "agent.learning_starts": 64,
        "agent.buffer_size": 320,
        "agent.batch_size": 16,
        "agent.gradient_steps": 1,
        "agent.policy_kwargs.net_arch": [16],
    },
    "ppo": {"agent.n_steps": 8, "agent.batch_size": 32, "agent.n_epochs": 1, "agent.policy_kwargs.net_arch": [16]},
}
TRAIN = {"simulation": "kinematic", "n_envs": 8, "total_timesteps": 256, "save_freq": 128, "keep": 9, "eval_freq": 0}


def _edited(source: Path, target: Path, place: str, value: Any) -> Path:
    """A checkpoint with another value at one place, such as "config/agent/name"; `...` removes it."""
    content = deepcopy(read_checkpoint(source))
    *path, last = place.split("/")
    branch = content
    for key in path:
        branch = branch[int(key) if isinstance(branch, list) else key]
    if value is ...:
        del branch[last]
    else:
        branch[last] = value(branch[last]) if callable(value) else value
    write_checkpoint(target, content)
    return target


def _refused(function: Any, *arguments: Any, **named: Any) -> str:
    """The one-line message of the `InputError` that a call raises."""
    with pytest.raises(InputError) as refused:
        function(*arguments, **named)
    assert len(str(refused.value).splitlines()) == 1
    return str(refused.value)


@pytest.fixture(scope="session")
def runs(tmp_path_factory) -> Path:
    """A folder with a run of each agent of `AGENTS` that was killed after its first checkpoint."""
    folder = tmp_path_factory.mktemp("runs")
    for agent, settings in AGENTS.items():
        config = resolve(agent, settings={f"train.{key}": value for key, value in TRAIN.items()} | settings)
        run = train_config(config, folder / agent).run
        for file in run.checkpoints[:-1]:
            file.unlink()
        shutil.rmtree(run.folder / "tensorboard")
        shutil.rmtree(run.folder / "final")
    return folder


@pytest.fixture(scope="session", params=AGENTS)
def checkpoint(request, runs) -> Path:
    """A checkpoint of each agent; read only."""
    return Run.open(runs / request.param).checkpoints[0]


@pytest.fixture(scope="session")
def dqn_checkpoint(runs) -> Path:
    """A checkpoint of dqn; read only."""
    return Run.open(runs / "dqn").checkpoints[0]


@pytest.fixture
def edited():
    """The function `_edited`."""
    return _edited


@pytest.fixture
def refused():
    """The function `_refused`."""
    return _refused
