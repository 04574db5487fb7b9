"""A signal ends a training with a checkpoint, from which the resumed one equals the undisturbed one, to the bit."""

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tb2rl import load
from tb2rl.envs.vec_env import TurtleBot2VecEnv
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
ENDLESS = ["--total-timesteps", "1000000000", "--simulation", "kinematic", "--n-envs", "4", "--name", "it"]
FEW_EPISODES = ["--set", "train.eval_episodes=2", "train.eval_steps=5"]


@pytest.fixture
def raise_at(monkeypatch):
    """Raises a signal in the given step of the environments, counted from 1."""

    def arrange(number: int, at: int) -> None:
        step, steps = TurtleBot2VecEnv.step_wait, iter(range(1, 1_000_000))

        def interrupted(env):
            if next(steps) == at:
                signal.raise_signal(number)
            return step(env)

        monkeypatch.setattr(TurtleBot2VecEnv, "step_wait", interrupted)

    return arrange


def timesteps(run: Run) -> int:
    return int(run.checkpoints[0].stem[5:])


@pytest.mark.parametrize(("agent", "number"), list(zip(AGENTS, SIGNALS, strict=False)))
def test_an_interrupted_training_resumes_to_the_bit(agent, number, raise_at, small, assert_same_runs, tmp_path):
    task, settings = AGENTS[agent]
    train = {"total_timesteps": 256, "eval_freq": 64, "eval_episodes": 2, "eval_steps": 20, "episode_steps": 40}
    config = small(agent, task, settings, **train)
    whole = train_config(config, tmp_path / "whole").run
    raise_at(number, at=25)  # within a rollout, if that has more than one step
    training = train_config(config, tmp_path / "run")
    run = training.run
    assert training.signal_number == number
    reached = timesteps(run)
    assert reached in range(100, 129), "where the next rollout starts"
    shutil.rmtree(run.folder / "final")
    assert resume(run.folder).timesteps == 256 - reached
    assert_same_runs(whole, run)


def test_a_signal_in_the_last_rollout_leaves_a_whole_training(raise_at, small, assert_same_runs, tmp_path):
    config = small("ppo", *AGENTS["ppo"], eval_freq=64, eval_episodes=2, eval_steps=20)
    whole = train_config(config, tmp_path / "whole").run
    raise_at(signal.SIGTERM, at=30)
    training = train_config(config, tmp_path / "run")
    assert (training.signal_number, training.timesteps) == (signal.SIGTERM, 128)
    assert_same_runs(whole, training.run)


def test_a_training_in_a_thread_sets_no_handlers_and_others_are_restored(small, tmp_path):
    before = list(map(signal.getsignal, SIGNALS))
    train_config(small(), tmp_path / "run")
    assert list(map(signal.getsignal, SIGNALS)) == before
    thread = threading.Thread(target=train_config, args=(small(), tmp_path / "thread"))
    thread.start()
    thread.join()
    assert load(tmp_path / "thread").num_timesteps == 128


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there is no hangup on Windows")
def test_a_hangup_that_nohup_lets_ignore_stays_ignored(raise_at, small, tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        raise_at(signal.SIGHUP, at=5)
        assert not train_config(small(), tmp_path / "run").signal_number
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_second_signal_stops_at_once(small, tmp_path, monkeypatch):
    step = TurtleBot2VecEnv.step_wait
    monkeypatch.setattr(TurtleBot2VecEnv, "step_wait", lambda env: signal.raise_signal(signal.SIGINT) or step(env))
    with pytest.raises(KeyboardInterrupt):
        train_config(small("ppo", *AGENTS["ppo"]), tmp_path / "run")
    assert not Run.open(tmp_path / "run").checkpoints


@pytest.mark.parametrize("number", SIGNALS)
def test_the_command_ends_with_the_status_that_shells_expect(number, raise_at, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    raise_at(number, at=5)
    status = 0
    try:
        main([*ENDLESS, "--total-timesteps", "128", "--eval-freq", "0"])
    except SystemExit as ended:
        status = ended.code
    assert status == (0 if number == signal.SIGINT else 128 + number)
    assert "stops after this rollout" in capsys.readouterr().out
    assert not Path("runs/maze/qlearn/it/evaluation.json").exists()
    main(["--resume", "runs/maze/qlearn/it", "--no-evaluation"])
    assert timesteps(Run.open(Path("runs/maze/qlearn/it"))) == 128


# ---- whole processes: real signals and kills, hence the reruns; each waits for files that the training writes


def started(folder: Path, *arguments: str, group: bool = False) -> subprocess.Popen:
    words = [sys.executable, "-m", "tb2rl.train", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(words, cwd=folder, start_new_session=group, **pipes)


def wait_for(process: subprocess.Popen, condition) -> None:
    """Wait until the condition holds; fail if the process ends or a minute passes."""
    deadline = time.monotonic() + 60
    while not condition():
        assert process.poll() is None, f"it ended before: {process.stderr.read()}"
        assert time.monotonic() < deadline, "waited a minute"
        time.sleep(0.02)


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 0), (signal.SIGTERM, 143)])
def test_a_signal_to_all_processes_saves_policy_and_checkpoint(number, status, tmp_path):
    flags = ["--simulation", "bullet", "--n-envs", "2", "--save-freq", "200", "--eval-freq", "100"]
    process = started(tmp_path, *ENDLESS, *flags, *FEW_EPISODES, group=True)
    folder = tmp_path / "runs" / "maze" / "qlearn" / "it"
    wait_for(process, lambda: list(folder.glob("checkpoints/*.safetensors")))
    os.killpg(process.pid, number)  # as a terminal does: to the workers too
    out, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (status, "")
    assert "stops after this rollout" in out
    assert load(folder / "final" / "policy.safetensors").num_timesteps == timesteps(Run.open(folder)) + 2
    assert not (folder / "evaluation.json").exists()


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)
def test_trainings_of_several_seeds_save_a_checkpoint_each(tmp_path):
    flags = ["--seeds", "0,1", "--workers", "2", "--save-freq", "0", "--eval-freq", "400"]
    process = started(tmp_path, *ENDLESS, *flags, *FEW_EPISODES)
    folders = [tmp_path / "runs" / "maze" / "qlearn" / "it" / f"seed-{seed}" for seed in (0, 1)]
    wait_for(process, lambda: all((folder / "evaluations.jsonl").is_file() for folder in folders))
    process.send_signal(signal.SIGTERM)
    out, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (143, "")
    assert "0 of 2 seeds are done" in out
    assert all("training" in read_checkpoint(Run.open(folder).checkpoints[0]) for folder in folders)


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)
def test_a_training_that_is_killed_at_any_moment_can_be_resumed(tmp_path):
    folder = tmp_path / "runs" / "maze" / "qlearn" / "it"
    arguments = [*ENDLESS, "--save-freq", "16", "--eval-freq", "0"]
    for delay in random.Random(0).sample(range(100), 5):  # [ms] after its first checkpoint
        process = started(tmp_path, "--no-evaluation", "--no-progress", *arguments)
        older = set(folder.glob("checkpoints/*.safetensors"))
        wait_for(process, lambda known=older: set(folder.glob("checkpoints/*.safetensors")) - known)
        time.sleep(delay / 1000)
        process.kill()
        process.communicate()
        assert load(folder).num_timesteps == timesteps(Run.open(folder))
        arguments = ["--resume", str(folder)]
