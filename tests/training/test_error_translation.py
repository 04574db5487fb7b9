"""Errors of the machine and of libraries are one line, and the last checkpoint stands."""

import errno
import multiprocessing
import os
import threading
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.simulation.simulator import default_physics
from tb2rl.tasks.wander import Wander
from tb2rl.training.training import resume, train_config

PPO = {"agent.n_steps": 16, "agent.batch_size": 32}


def test_a_full_disk_is_named_though_tensorboard_writes_in_a_thread(small, tmp_path, monkeypatch):
    full, shown = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))), []
    monkeypatch.setattr("tensorboard.summary.writer.record_writer.RecordWriter.write", full)
    monkeypatch.setattr(threading, "excepthook", shown.append)
    with pytest.raises(InputError, match="No space left"):
        train_config(small(), tmp_path / "run")
    assert shown == [], "tracebacks of threads"


def test_a_killed_simulator_process_is_named_and_none_is_left(small, tmp_path, monkeypatch):
    batch_module = pytest.importorskip("tb2rl.simulation.bullet.batch", reason="PyBullet is not installed")
    before, step = set(multiprocessing.active_children()), batch_module.BulletBatch.step

    def killed(batch, *arguments):
        for process in batch._processes:
            process.kill()
            process.join()
        return step(batch, *arguments)

    monkeypatch.setattr(batch_module, "processors", lambda: 3)
    monkeypatch.setattr(batch_module.BulletBatch, "step", killed)
    with pytest.raises(InputError, match="a process with PyBullet environments has ended"):
        train_config(small(simulation="bullet", n_envs=3), tmp_path / "run")
    assert set(multiprocessing.active_children()) <= before


def test_a_folder_that_cannot_be_written_is_named_and_the_last_checkpoint_stands(small, tmp_path, monkeypatch):
    run = train_config(small(), tmp_path / "run").run
    refuse = Mock(side_effect=OSError(errno.EROFS, os.strerror(errno.EROFS)))
    monkeypatch.setattr(Path, "replace", refuse)  # permissions do not stop root
    with pytest.raises(InputError, match=os.strerror(errno.EROFS)) as stopped:
        resume(run.folder, 256)
    assert "\n" not in str(stopped.value)
    assert load(run.folder).num_timesteps == int(run.checkpoints[0].stem[5:]) == 128
    assert not [file for file in run.folder.rglob(".*") if file.name != ".lock"], "nothing half-written is left"


def test_too_little_memory_is_named(small, tmp_path, monkeypatch):
    monkeypatch.setattr("tb2rl.envs.vec_env.TurtleBot2VecEnv.step_wait", Mock(side_effect=MemoryError))
    with pytest.raises(InputError, match=r"not enough memory: .*train\.n_envs"):
        train_config(small(), tmp_path / "run")


@pytest.mark.filterwarnings("ignore:Mean of empty slice", "ignore:invalid value encountered")
@pytest.mark.parametrize(
    ("agent", "settings", "message"),
    [
        ("ppo", {**PPO, "agent.learning_rate": 1e8}, r"diverged .*smaller agent\.learning_rate"),
        ("ppo", {**PPO, "agent.n_epochs": 0}, r"agent ppo .*rejects its settings.*n_epochs"),
        ("sb3_contrib:ARS", {}, "ARS does not pass rewards, dones and infos to callbacks"),
    ],
)
def test_settings_that_fail_while_learning_are_named(agent, settings, message, small, tmp_path):
    if "diverged" in message:  # ReLU grows without bounds
        settings = {**settings, "task.observation": "raw", "agent.policy_kwargs.activation_fn": "torch.nn:ReLU"}
    with pytest.raises(InputError, match=message) as stopped:
        train_config(small(agent, settings=settings, total_timesteps=2000), tmp_path / "run")
    assert "\n" not in str(stopped.value)


def test_an_error_in_a_task_keeps_its_traceback(small, tmp_path, monkeypatch):
    simulations = ("kinematic", default_physics().name)
    configs = {simulation: small(simulation=simulation, n_envs=1) for simulation in simulations}
    monkeypatch.setattr(Wander, "outcome", lambda *_: np.zeros(3) + np.zeros(4))
    for simulation, config in configs.items():
        with pytest.raises(ValueError, match="could not be broadcast") as bug:
            train_config(config, tmp_path / simulation)
        assert not isinstance(bug.value, InputError)
