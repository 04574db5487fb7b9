"""Whole trainings, killed with SIGKILL halfway and resumed, held against the same ones that nobody disturbed.

    python tests/training/kill_and_resume.py          # all, 20 000 steps each: a quarter of an hour on two cores
    python tests/training/kill_and_resume.py sac      # those whose name begins so

What is compared, to the bit: the last checkpoint (weights, optimisers, replay buffer, statistics, generators,
environments), the best and the final policy, and the evaluations on the way. Exit status 1 if anything differs.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from conftest import _differences

from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.folder import Run

STEPS = 20_000
SB3, CONTRIB = "stable_baselines3", "sb3_contrib"
NORMALISED = ["train.norm_obs=true", "train.norm_reward=true"]
FRAMES = ["task.frame_stack=4"]
CAMERA = ["task.observe=[laser, {camera: {width: 36, height: 36}}]"]
SMALL = ["agent.policy_kwargs.net_arch=[64,64]"]
ON_POLICY = ["agent.n_steps=64", "agent.batch_size=128", "agent.n_epochs=4"]
OFF_POLICY = ["agent.buffer_size=8000", "agent.learning_starts=1000", "agent.batch_size=64"]  # full when it is killed
MEMORY = ["agent.policy_kwargs.lstm_hidden_size=32"]
TRAININGS = {  # agent, task, settings
    "sac": ("sac", "drive", OFF_POLICY),
    "td3": ("td3", "drive", OFF_POLICY),
    "recurrent_ppo": ("recurrent_ppo", "drive", ON_POLICY),
    "SAC, normalised frames": (f"{SB3}:SAC", "drive", [*OFF_POLICY, *SMALL, *NORMALISED, *FRAMES]),
    "TD3, normalised frames": (f"{SB3}:TD3", "drive", [*OFF_POLICY, *SMALL, *NORMALISED, *FRAMES]),
    "RecurrentPPO, normalised frames": (
        f"{CONTRIB}:RecurrentPPO",
        "drive",
        [*ON_POLICY, *SMALL, *MEMORY, *NORMALISED, *FRAMES],
    ),
    "PPO, normalised": (f"{SB3}:PPO", "maze", [*ON_POLICY, *SMALL, *NORMALISED]),
    "PPO, normalised frames, camera": (f"{SB3}:PPO", "maze", [*ON_POLICY, *SMALL, *NORMALISED, *FRAMES, *CAMERA]),
    "SAC, camera": (f"{SB3}:SAC", "drive", [*OFF_POLICY, *SMALL, *CAMERA, "agent.gradient_steps=1"]),
    "DQN, frames in PyBullet": (f"{SB3}:DQN", "maze", [*OFF_POLICY, *SMALL, *FRAMES, "train.simulation=bullet"]),
}


def begin(name: str, run: str, cwd: Path) -> tuple[subprocess.Popen, Path]:
    """The process of a training, and its folder."""
    agent, task, settings = TRAININGS[name]
    train = ["task.laser_noise=0.01", "train.simulation=kinematic", "train.n_envs=16", "train.stop_score=null"]
    train += [f"train.eval_freq={STEPS // 5}", "train.eval_episodes=20", "train.eval_steps=100", "train.keep=2"]
    flags = ["--name", run, "--total-timesteps", str(STEPS), "--save-freq", str(STEPS // 2)]
    words = ["--agent", agent, "--task", task, *flags, "--set", *train, *settings]
    return command(words, cwd), cwd / "runs" / task / agent.rpartition(":")[2] / run


def command(arguments: list[str], cwd: Path) -> subprocess.Popen:
    path = str(Path(__file__).parents[2])
    words = [sys.executable, "-m", "tb2rl.train", "--no-evaluation", *arguments]
    return subprocess.Popen(words, cwd=cwd, env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.DEVNULL)


def evaluations(folder: Path) -> list[dict]:
    file = folder / "evaluations.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    return [{k: v for k, v in json.loads(line).items() if k not in ("seconds", "elapsed")} for line in lines]


def kill_past_the_checkpoint(process: subprocess.Popen, folder: Path) -> int:
    """Kill a training once it has evaluated after its checkpoint; returns the steps that it had by then."""
    while not (evaluations(folder) and evaluations(folder)[-1]["timesteps"] > STEPS // 2):
        assert process.poll() is None, "it was over before it could be killed"
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    return evaluations(folder)[-1]["timesteps"]


def compare(name: str, cwd: Path) -> list[str]:
    """What differs between a training that was killed and one that was not."""
    whole, folder = begin(name, "whole", cwd)
    assert whole.wait() == 0
    process, killed = begin(name, "killed", cwd)
    past = kill_past_the_checkpoint(process, killed)
    checkpoints = Run.open(killed).checkpoints
    print(f"{name}: killed after more than {past} steps, goes on from {checkpoints[0].stem}", flush=True)
    assert command(["--resume", str(killed)], cwd).wait() == 0
    runs = [Run.open(folder), Run.open(killed)]
    files = [
        [run.checkpoints[0], run.folder / "best/policy.safetensors", run.folder / "final/policy.safetensors"]
        for run in runs
    ]
    found = [line for pair in zip(*files, strict=True) for line in _differences(*map(read_checkpoint, pair))]
    if evaluations(folder) != evaluations(killed) or len(evaluations(folder)) < 5:
        found.append("evaluations.jsonl")
    return found


def main() -> None:
    """Compare those whose names were given, else all."""
    wanted = tuple(sys.argv[1:]) or ("",)
    failed = 0
    for name in (name for name in TRAININGS if name.startswith(wanted)):
        with TemporaryDirectory() as cwd:
            started, found = time.monotonic(), compare(name, Path(cwd))
        print(f"{name}: {found or 'equal to the bit'} ({time.monotonic() - started:.0f} s)", flush=True)
        failed += bool(found)
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
