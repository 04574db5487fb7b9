"""A training that a signal ends saves a checkpoint, and the resumed one is the undisturbed one, to the bit."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tb2rl.envs.vec_env import BatchVecEnv
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.train import main
from tb2rl.training.training import resume, train_config

SMALL = {"agent.policy_kwargs.net_arch": [8], "task.observation": "raw", "task.laser_noise": 0.01}
OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 200, "agent.batch_size": 16, "agent.gradient_steps": 1}
AGENTS = {
    "qlearn": ("maze", {"task.laser_noise": 0.01}),
    "ppo": ("maze", {**SMALL, "agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 1}),
    "sac": ("drive", {**SMALL, **OFF_POLICY, "agent.train_freq": 8}),
}
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.fixture
def raised(monkeypatch):
    """A function that lets a signal come in the step of the environments of that number, counted from 1."""

    def arrange(number: int, at: int) -> None:
        step, steps = BatchVecEnv.step_wait, iter(range(1, 1_000_000))

        def interrupted(env):
            if next(steps) == at:
                signal.raise_signal(number)
            return step(env)

        monkeypatch.setattr(BatchVecEnv, "step_wait", interrupted)

    return arrange


def notes(run: Run) -> list[dict]:
    lines = (run.folder / "evaluations.jsonl").read_text().splitlines()
    return [{k: v for k, v in json.loads(line).items() if k not in {"seconds", "elapsed"}} for line in lines]


@pytest.mark.parametrize(("agent", "number"), [*zip(AGENTS, SIGNALS, strict=False), ("qlearn", SIGNALS[-1])])
def test_a_training_that_a_signal_ends_goes_on_to_the_bit(agent, number, raised, small, differences, tmp_path):
    task, settings = AGENTS[agent]
    train = {"total_timesteps": 512, "eval_freq": 128, "eval_episodes": 2, "eval_steps": 20, "episode_steps": 40}
    config = small(agent, task, settings, **train)
    whole = train_config(config, tmp_path / "whole").run
    raised(number, at=41)  # in the middle of a rollout, if that has more than one step
    training = train_config(config, tmp_path / "run")
    run = training.run
    assert training.interrupted == number
    assert int(run.checkpoints[0].stem[5:]) in range(164, 193), "where the next rollout starts"
    shutil.rmtree(run.folder / "final")
    assert 320 <= resume(run.folder).timesteps < 360
    assert differences(*(read_checkpoint(each.checkpoints[0]) for each in (whole, run))) == []
    assert differences(*(read_checkpoint(each.policy_file) for each in (whole, run))) == []
    assert notes(whole) == notes(run)


def test_a_signal_in_the_last_rollout_leaves_a_whole_training(raised, small, differences, tmp_path):
    task, settings = AGENTS["ppo"]
    config = small("ppo", task, settings, eval_freq=64, eval_episodes=2, eval_steps=20)
    whole = train_config(config, tmp_path / "whole").run
    raised(signal.SIGTERM, at=30)
    training = train_config(config, tmp_path / "run")
    assert (training.interrupted, training.timesteps) == (signal.SIGTERM, 128)
    assert differences(*(read_checkpoint(run.checkpoints[0]) for run in (whole, training.run))) == []
    assert notes(whole) == notes(training.run)


def test_signals_are_handled_as_before_once_the_training_is_over(small, tmp_path):
    before = list(map(signal.getsignal, SIGNALS))
    train_config(small(), tmp_path / "run")
    assert list(map(signal.getsignal, SIGNALS)) == before


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there is no hangup on Windows")
def test_a_hangup_that_nohup_lets_ignore_stays_ignored(raised, small, tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        raised(signal.SIGHUP, at=5)
        assert not train_config(small(), tmp_path / "run").interrupted
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", SIGNALS)
def test_the_command_ends_with_the_status_that_shells_count(number, raised, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    raised(number, at=5)
    steps = ["--simulation", "kinematic", "--n-envs", "4", "--total-timesteps", "128"]
    status = 0
    try:
        main([*steps, "--eval-freq", "0", "--name", "it"])
    except SystemExit as ended:
        status = ended.code
    assert status == (0 if number == signal.SIGINT else 128 + number)
    assert "stopping" in capsys.readouterr().out
    assert not Path("runs/maze/qlearn/it/evaluation.json").exists()
    main(["--resume", "runs/maze/qlearn/it", "--no-evaluation"])
    assert Run.open(Path("runs/maze/qlearn/it")).checkpoints[0].stem == "step-0000000128"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals as on Linux")
def test_trainings_of_several_seeds_save_a_checkpoint_each(tmp_path):
    flags = ["--seeds", "0,1", "--workers", "2", "--name", "it", "--simulation", "kinematic", "--n-envs", "4"]
    flags += ["--total-timesteps", "1000000000", "--save-freq", "0", "--eval-freq", "400"]
    words = [sys.executable, "-m", "tb2rl.train", *flags, "--set", "train.eval_episodes=2", "train.eval_steps=5"]
    process = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    folders = [tmp_path / "runs" / "maze" / "qlearn" / "it" / f"seed-{seed}" for seed in (0, 1)]
    while not all((folder / "evaluations.jsonl").is_file() for folder in folders):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    out, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (143, ""), error
    assert "0 of 2 seeds are done" in out
    for folder in folders:
        (file,) = Run.open(folder).checkpoints
        assert "training" in read_checkpoint(file)
