"""A resumed training goes on as if nothing had happened, and a killed one loses nothing."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from filelock import FileLock
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl import load
from tb2rl.checkpoint import read_checkpoint
from tb2rl.config import resolve
from tb2rl.errors import InputError
from tb2rl.runs import Run
from tb2rl.training import resume, train_config

SMALL = {
    "dqn": {"agent.learning_starts": 300, "agent.target_update_interval": 500, "agent.buffer_size": 1500},
    "ppo": {"agent.n_steps": 32, "agent.batch_size": 64},
    "qlearn": {},
    "stable_baselines3:A2C": {"task.observation": "raw"},
}
TIMED = {"elapsed"}  # what a clock says


def differences(one: Any, other: Any, path: str = "") -> Iterator[str]:
    """Where two trees differ, to the bit."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        if one.keys() != other.keys():
            yield f"{path}: {sorted(one.keys() ^ other.keys())}"
        for key in one.keys() & other.keys() - TIMED:
            yield from differences(one[key], other[key], f"{path}/{key}")
    elif isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            yield f"{path}: lengths {len(one)}, {len(other)}"
        for i, (a, b) in enumerate(zip(one, other, strict=False)):
            yield from differences(a, b, f"{path}/{i}")
    elif isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.dtype != other.dtype or one.shape != other.shape or one.tobytes() != other.tobytes():
            yield path
    elif one != other:
        yield f"{path}: {one!r}, {other!r}"


def killed_after_its_first_checkpoint(folder: Path, whole: Path) -> Path:
    """What `kill -9` leaves after the first checkpoint, some of what came later included."""
    shutil.copytree(whole, folder)
    for file in Run.open(folder).checkpoints[:-1]:
        file.unlink()
    shutil.rmtree(folder / "final")
    return folder


@pytest.mark.parametrize("simulation", ["kinematic", "bullet"])
@pytest.mark.parametrize("agent", SMALL)
def test_a_resumed_training_is_the_uninterrupted_one(agent, simulation, tmp_path):
    worlds = 8 if simulation == "kinematic" else 2
    train = {"simulation": simulation, "n_envs": worlds, "total_timesteps": 2048, "save_freq": 1024, "keep": 9}
    train |= {"eval_freq": 512, "eval_episodes": 2, "eval_steps": 20, "episode_steps": 60}
    noise = {"task.noise": 0.01}
    config = resolve(agent, settings={f"train.{key}": value for key, value in train.items()} | SMALL[agent] | noise)
    train_config(config, tmp_path / "whole")
    whole = Run.open(tmp_path / "whole")
    assert len(whole.checkpoints) >= 2
    resumed = Run.open(killed_after_its_first_checkpoint(tmp_path / "resumed", whole.folder))
    training = resume(resumed.folder)
    assert 0 < training.timesteps < 2048
    ends = [read_checkpoint(run.checkpoints[0]) for run in (whole, resumed)]
    assert list(differences(*ends)) == []
    assert list(differences(*(read_checkpoint(run.policy_file) for run in (whole, resumed)))) == []
    notes = [
        [{k: v for k, v in json.loads(line).items() if k not in {"seconds", "elapsed"}} for line in lines]
        for lines in ((run.folder / "evaluations.jsonl").read_text().splitlines() for run in (whole, resumed))
    ]
    assert notes[0] == notes[1], "no evaluation twice, none missing"
    axes = []
    for run in (whole, resumed):
        events = EventAccumulator(str(run.folder / "tensorboard"))
        events.Reload()
        axes.append([(e.step, e.value) for e in events.Scalars("eval/mean_return")])
    assert axes[0] == axes[1], "no gap and no overlap"
    assert len(axes[0]) >= 4


def test_a_finished_run_goes_on_when_more_is_asked(tmp_path):
    config = resolve("qlearn", settings={"train.total_timesteps": 64, "train.n_envs": 1, "train.eval_freq": 0})
    train_config(config, tmp_path / "run")
    with pytest.raises(InputError, match="has all its 64 steps"):
        resume(tmp_path / "run")
    with pytest.raises(InputError, match="begun with 64"):
        resume(tmp_path / "run", 32)
    assert resume(tmp_path / "run", 128).timesteps == 64
    assert Run.open(tmp_path / "run").config.train.total_timesteps == 128
    assert load(tmp_path / "run").num_timesteps == 128


def test_a_run_that_goes_on_keeps_its_best_score(tmp_path):
    settings = {"train.total_timesteps": 64, "train.n_envs": 1, "train.eval_freq": 64, "train.eval_episodes": 2}
    run = train_config(resolve("qlearn", settings={**settings, "train.eval_steps": 20}), tmp_path / "run").run
    remembered = read_checkpoint(run.checkpoints[0])["training"]["callbacks"]
    noted = json.loads((run.folder / "evaluations.jsonl").read_text().splitlines()[-1])
    assert [state["best"] for state in remembered if "best" in state] == [[noted["success_rate"], noted["mean_return"]]]


def test_old_checkpoints_are_pruned_but_never_the_last(tmp_path):
    settings = {"train.total_timesteps": 64, "train.n_envs": 1, "train.eval_freq": 0, "train.save_freq": 10}
    run = train_config(resolve("qlearn", settings={**settings, "train.keep": 3}), tmp_path / "run").run
    assert [int(file.stem[5:]) for file in run.checkpoints] == [64, 60, 50]


def test_two_processes_do_not_train_in_one_folder(tmp_path):
    settings = {"train.total_timesteps": 64, "train.n_envs": 1, "train.eval_freq": 0}
    run = train_config(resolve("qlearn", settings=settings), tmp_path / "run").run
    with FileLock(run.folder / ".lock"), pytest.raises(InputError, match="another process"):
        resume(run.folder, 128)
    assert resume(run.folder, 128).timesteps == 64


def test_another_runs_checkpoint_is_not_gone_on_with(tmp_path):
    settings = {"train.total_timesteps": 64, "train.n_envs": 1, "train.eval_freq": 0}
    configs = [resolve("qlearn", settings=settings | {"train.seed": seed}) for seed in (0, 1)]
    runs = [train_config(config, tmp_path / str(i)).run for i, config in enumerate(configs)]
    shutil.copy(runs[0].checkpoints[0], runs[1].checkpoints[0])
    with pytest.raises(InputError, match="not a checkpoint of the training that"):
        resume(runs[1].folder, 128)


@pytest.mark.parametrize("agent", ["qlearn", "ppo"])
def test_the_same_seed_gives_the_same_weights_whatever_the_threads(agent, tmp_path):
    train = {"simulation": "kinematic", "n_envs": 600, "total_timesteps": 6000, "eval_freq": 0}
    config = resolve(agent, settings={f"train.{key}": value for key, value in train.items()} | SMALL[agent])
    ends = []
    try:
        for threads in (1, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(threads)
            run = train_config(config, tmp_path / str(len(ends))).run
            ends.append(read_checkpoint(run.checkpoints[0]))
    finally:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    assert list(differences(*ends)) == []


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


def test_a_full_disk_is_named_and_the_last_checkpoint_stands(small_disk):
    settings = {"train.simulation": "kinematic", "train.n_envs": 4, "train.eval_freq": 0, "train.save_freq": 500}
    with pytest.raises(InputError, match="No space left") as stopped:
        train_config(resolve("dqn", settings={**settings, "train.total_timesteps": 20_000}), small_disk / "run")
    assert "\n" not in str(stopped.value)
    run = Run.open(small_disk / "run")
    assert load(run.folder).num_timesteps == timesteps(run.folder) >= 500
    assert not [file for file in run.folder.rglob(".*") if file.name != ".lock"], "nothing half-written is left"


def test_a_folder_that_becomes_read_only_is_named_and_the_last_checkpoint_stands(tmp_path, monkeypatch):
    config = resolve("qlearn", settings={"train.total_timesteps": 64, "train.n_envs": 1, "train.eval_freq": 0})
    run = train_config(config, tmp_path / "run").run

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "replace", refuse)  # no permission holds root back
    with pytest.raises(InputError, match="Read-only file system"):
        resume(run.folder, 128)
    assert timesteps(run.folder) == load(run.folder).num_timesteps == 64


@pytest.mark.slow
def test_a_training_that_is_killed_at_any_moment_can_be_resumed(tmp_path):
    """Fifty kills of one training that saves as often as it can, each followed by a look at what is left."""
    folder = tmp_path / "runs" / "maze" / "qlearn" / "run"
    start = [sys.executable, "-m", "tb2rl.train", "--no-evaluation", "--no-progress"]
    first = "--agent qlearn --simulation kinematic --n-envs 16 --total-timesteps 100000000 --save-freq 16 --eval-freq 0"
    rng, steps = random.Random(0), []
    for kill in range(50):
        arguments = ["--resume", str(folder)] if kill else [*first.split(), "--name", "run"]
        process = subprocess.Popen([*start, *arguments], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        before = steps[-1] if steps else -1
        while not (folder.is_dir() and Run.open(folder).checkpoints and timesteps(folder) > before):
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert load(folder).num_timesteps == timesteps(folder)
        steps.append(timesteps(folder))
    assert steps == sorted(steps)


def timesteps(folder: Path) -> int:
    return int(Run.open(folder).checkpoints[0].stem[5:])
