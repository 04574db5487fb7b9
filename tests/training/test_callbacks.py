"""What happens beside a training: checkpoints now and then, and stopping."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time

import pytest

from tb2rl import load
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.training.callbacks import Checkpoints, StopOnInterrupt
from tb2rl.training.training import train_config


def timesteps(run: Run) -> int:
    return int(run.checkpoints[0].stem[5:])


def test_old_checkpoints_are_removed_but_never_the_last(small, tmp_path):
    config = small(n_envs=1, total_timesteps=64, save_freq=10, keep=3)
    run = train_config(config, tmp_path / "run").run
    assert [int(file.stem[5:]) for file in run.checkpoints] == [64, 60, 50]


def test_without_a_save_frequency_there_is_the_last_checkpoint_alone(small, tmp_path):
    run = train_config(small(save_freq=0), tmp_path / "run").run
    assert [int(file.stem[5:]) for file in run.checkpoints] == [128]


@pytest.mark.slow
def test_a_full_replay_buffer_is_saved_and_loaded_in_two_seconds(small, monkeypatch, tmp_path):
    rows, seconds = 100_000, []
    save = Checkpoints.save

    def timed(what, *arguments):
        started = time.monotonic()
        found = what(*arguments)
        seconds.append(time.monotonic() - started)
        return found

    monkeypatch.setattr(Checkpoints, "save", lambda self: timed(save, self))
    settings = {"agent.buffer_size": rows, "agent.learning_starts": 10 * rows, "task.beams": 36}
    run = train_config(small("dqn", settings=settings, n_envs=250, total_timesteps=rows), tmp_path / "run").run
    content = timed(read_checkpoint, run.checkpoints[0])
    assert content["training"]["replay_buffer"]["observations"].shape == (rows // 250, 250, 36)
    timed(load, run.checkpoints[0])
    print("saved, read and loaded in", seconds, "s:", run.checkpoints[0].stat().st_size, "bytes")
    assert len(seconds) == 3
    assert max(seconds) <= 2


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGINT, 0),
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, 129, marks=pytest.mark.slow),
    ],
)
def test_a_signal_to_all_processes_saves_policy_and_checkpoint_and_ends_well(number, status, tmp_path):
    arguments = ["--name", "it", "--total-timesteps", "1000000000", "--n-envs", "2", "--save-freq", "200"]
    evaluating = ["--eval-freq", "100", "--set", "train.eval_episodes=2", "train.eval_steps=5"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": tmp_path}
    process = subprocess.Popen(
        [sys.executable, "-m", "tb2rl.train", *arguments, *evaluating], **pipes, start_new_session=True
    )
    folder = tmp_path / "runs" / "maze" / "qlearn" / "it"
    deadline = time.monotonic() + 60
    while not list(folder.glob("checkpoints/*.safetensors")):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    os.killpg(process.pid, number)  # as a terminal does: to the workers too
    out, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (status, "")
    assert "stopping" in out
    assert load(folder / "final" / "policy.safetensors").num_timesteps == timesteps(Run.open(folder)) + 2
    assert not (folder / "evaluation.json").exists()


def test_a_second_ctrl_c_stops_at_once():
    before = signal.getsignal(signal.SIGINT)
    with StopOnInterrupt(lambda: None) as stop:
        stop._on_rollout_start()
        assert stop._on_step()
        signal.raise_signal(signal.SIGINT)
        stop._on_rollout_start()
        assert not stop._on_step()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_a_training_in_another_thread_takes_no_signals(small, tmp_path):
    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=train_config, args=(small(), tmp_path / "run"))
    thread.start()
    thread.join()
    assert load(tmp_path / "run").num_timesteps == 128
    assert signal.getsignal(signal.SIGINT) is before


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
        while not any(folder.glob("checkpoints/*.safetensors")) or timesteps(Run.open(folder)) <= before:
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.05)
        time.sleep(rng.uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert load(folder).num_timesteps == timesteps(Run.open(folder))
        steps.append(timesteps(Run.open(folder)))
    assert steps == sorted(steps)
