"""What stops a training from outside of our code is said in one line, and the last checkpoint stands."""

from __future__ import annotations

import errno
import multiprocessing
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.runs.folder import Run
from tb2rl.simulation.bullet.batch import BulletBatch
from tb2rl.tasks.wander import Wander
from tb2rl.training.training import resume, train_config

PPO = {"agent.n_steps": 16, "agent.batch_size": 32}


def timesteps(run: Run) -> int:
    return int(run.checkpoints[0].stem[5:])


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A disk of 3 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    if mount is None or subprocess.run([mount, "-t", "tmpfs", "-o", "size=3m", "tmpfs", place], check=False).returncode:
        pytest.skip("a small disk needs the right to mount one")
    yield place
    subprocess.run(["umount", place], check=True)


def test_a_full_disk_is_named_and_the_last_checkpoint_stands(small_disk, small):
    with pytest.raises(InputError, match="No space left") as stopped:
        train_config(small("dqn", save_freq=500, total_timesteps=20_000), small_disk / "run")
    assert "\n" not in str(stopped.value)
    run = Run.open(small_disk / "run")
    assert load(run.folder).num_timesteps == timesteps(run) >= 500
    assert not [file for file in run.folder.rglob(".*") if file.name != ".lock"], "nothing half-written is left"


def test_a_full_disk_is_named_in_one_line_where_tensorboard_writes_beside_the_training(small, tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    shown = []
    monkeypatch.setattr("tensorboard.summary.writer.record_writer.RecordWriter.write", full)
    monkeypatch.setattr(threading, "excepthook", shown.append)
    with pytest.raises(InputError, match="No space left"):
        train_config(small(), tmp_path / "run")
    assert shown == [], "tracebacks of threads"


def test_a_process_with_worlds_that_is_killed_is_named_and_none_is_left(small, tmp_path, monkeypatch):
    before, step = set(multiprocessing.active_children()), BulletBatch.step

    def killed(batch, *arguments):
        for process in batch._processes:
            process.kill()
            process.join()
        return step(batch, *arguments)

    monkeypatch.setattr("tb2rl.simulation.bullet_batch.processors", lambda: 3)
    monkeypatch.setattr(BulletBatch, "step", killed)
    with pytest.raises(InputError, match="a process with worlds of PyBullet has ended"):
        train_config(small(simulation="bullet", n_envs=3), tmp_path / "run")
    assert set(multiprocessing.active_children()) <= before


def test_a_folder_that_becomes_read_only_is_named_and_the_last_checkpoint_stands(small, tmp_path, monkeypatch):
    run = train_config(small(), tmp_path / "run").run

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "replace", refuse)  # no permission holds root back
    with pytest.raises(InputError, match="Read-only file system"):
        resume(run.folder, 256)
    assert timesteps(run) == load(run.folder).num_timesteps == 128


def test_too_little_memory_is_named(small, tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("tb2rl.envs.vec_env.BatchVecEnv.step_wait", full)
    with pytest.raises(InputError, match=r"not enough memory: .*train\.n_envs"):
        train_config(small(), tmp_path / "run")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("agent", "settings"), [("ppo", PPO), ("stable_baselines3:A2C", {"agent.n_steps": 8})])
def test_weights_that_are_not_finite_are_named(agent, settings, small, tmp_path):
    settings = {**settings, "agent.learning_rate": 1e8, "task.observation": "raw"}
    settings["agent.policy_kwargs.activation_fn"] = "torch.nn:ReLU"  # which grows beyond every bound
    with pytest.raises(InputError, match=r"diverged .*smaller agent\.learning_rate") as stopped:
        train_config(small(agent, settings=settings, total_timesteps=2000), tmp_path / "run")
    assert str(tmp_path / "run") in str(stopped.value)
    assert "\n" not in str(stopped.value)


@pytest.mark.filterwarnings("ignore:Mean of empty slice", "ignore:invalid value encountered")
@pytest.mark.parametrize(
    ("agent", "setting"),
    [("ppo", {"agent.n_epochs": 0}), ("dqn", {"agent.batch_size": -1}), ("dqn", {"agent.train_freq": 0})],
)
def test_settings_that_fail_while_learning_are_named(agent, setting, small, tmp_path):
    settings = PPO if agent == "ppo" else {"agent.learning_starts": 8}
    with pytest.raises(InputError, match=f"agent {agent} .*refuses its settings") as stopped:
        train_config(small(agent, settings={**settings, **setting}), tmp_path / "run")
    assert next(iter(setting)).removeprefix("agent.") in str(stopped.value)
    assert "\n" not in str(stopped.value)


def test_an_error_in_a_task_keeps_its_traceback(small, tmp_path, monkeypatch):
    configs = {simulation: small(simulation=simulation, n_envs=1) for simulation in ("kinematic", "bullet")}
    monkeypatch.setattr(Wander, "outcome", lambda *_: np.zeros(3) + np.zeros(4))
    for simulation, config in configs.items():
        with pytest.raises(ValueError, match="could not be broadcast") as bug:
            train_config(config, tmp_path / simulation)
        assert not isinstance(bug.value, InputError)


def test_an_algorithm_that_does_not_tell_of_its_steps_is_refused(small, tmp_path):
    with pytest.raises(InputError, match="ARS does not tell its callbacks of every step") as refused:
        train_config(small("sb3_contrib:ARS"), tmp_path / "run")
    assert "\n" not in str(refused.value)
