"""Runs that were killed after their first checkpoint, small changes to checkpoints, and trainings that may hang."""

from __future__ import annotations

import json
import pickle
import select
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from tb2rl.core.errors import InputError
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
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
SECONDS = 20.0  # that a few steps may take
ATTEMPTS = 250  # cases of a process: what each leaves behind must not be what another one fails for


class Attempts:
    """A process that attempts to train, see `attempts.py`; another one takes over if it hangs or dies."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None

    def __call__(self, case: dict[str, Any]) -> str:
        """What is wrong with how a case goes; "" if nothing is."""
        if self._process is None or self._count >= ATTEMPTS:
            self.stop()
            self._start()
        self._count += 1
        try:
            self._process.stdin.write(pickle.dumps(case))
            self._process.stdin.flush()
            if not select.select([self._process.stdout], [], [], SECONDS)[0]:
                wrong = f"hangs for more than {SECONDS:g} s"
            elif line := self._process.stdout.readline():
                return json.loads(line)
            else:
                wrong = f"kills its process, exit code {self._process.wait(5)}"
        except BrokenPipeError:
            wrong = f"kills its process, exit code {self._process.wait(5)}"
        self.stop()
        return wrong

    def _start(self) -> None:
        self._count = 0
        program = [sys.executable, str(Path(__file__).with_name("attempts.py"))]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(program, **pipes)
        assert json.loads(self._process.stdout.readline()) == "ready"

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                with suppress(BrokenPipeError):
                    pipe.close()
            self._process = None


def _edited(source: Path, target: Path, place: str, value: Any) -> Path:
    """A checkpoint with another value at one place, such as "config/agent/name"; `...` takes it away."""
    content = deepcopy(read_checkpoint(source))
    *path, last = place.split("/")
    branch = content
    for key in path:
        branch = branch[int(key) if isinstance(branch, list) or key.isdigit() else key]
    if value is ...:
        del branch[last]
    else:
        branch[last] = value(branch[last]) if callable(value) else value
    write_checkpoint(target, content)
    return target


def _refused(what: Any, *arguments: Any, **named: Any) -> str:
    """The message of the `InputError` that a call ends in; it is one line."""
    with pytest.raises(InputError) as refused:
        what(*arguments, **named)
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
    """A checkpoint of each agent; not to be changed."""
    return Run.open(runs / request.param).checkpoints[0]


@pytest.fixture
def edited():
    """The function `_edited`."""
    return _edited


@pytest.fixture
def refused():
    """The function `_refused`."""
    return _refused


@pytest.fixture(scope="session")
def attempt_settings() -> Iterator[Callable[[dict[str, Any]], str]]:
    """A function that attempts to train and says what is wrong with how it goes, see `Attempts`."""
    attempts = Attempts()
    yield attempts
    attempts.stop()
