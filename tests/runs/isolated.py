"""Tries settings and damaged checkpoints in a process that may hang, crash or exhaust memory; see `Isolated`.

Reads pickled cases from stdin, and answers each with a line of JSON: "works", "refused" or "failed", and why.
"""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import resource
import shutil
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from damage import damaged

from tb2rl.core.errors import InputError
from tb2rl.runs.config import Config
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.runs.loading import load
from tb2rl.training.training import resume, train_config

STEPS = 8
MEMORY = 4 * 2**30  # [bytes] of address space for the cases of a process

# Long trainings are shortened after their settings have been checked; allocations are not.
LONG_TRAINING = {"total_timesteps": STEPS, "eval_steps": STEPS}
LONG_ALGORITHM = {"n_epochs": 2, "gradient_steps": 2, "train_freq": STEPS}


def attempt(function: Callable[[], Any], named: Sequence[str]) -> tuple[str, str]:
    """The outcome of a call; a refusal is one line that has one of the names in it."""
    try:
        function()
    except InputError as error:
        message = str(error)
        clean = "\n" not in message and any(name in message or name in message.lower() for name in named)
        return ("refused" if clean else "failed"), message
    except BaseException as error:  # a panic of safetensors is no Exception
        frames = traceback.extract_tb(error.__traceback__)[-3:]
        places = " > ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in frames)
        return "failed", f"{type(error).__name__} at {places}: {error}"
    return "works", ""


def train_with(folder: Path, named: Sequence[str], **case: Any) -> tuple[str, str]:
    """Train for a few steps with `settings`, `pairs` of a --set, and `preset`, the bytes of a file."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        warnings.filterwarnings("ignore", category=UserWarning, module="stable_baselines3")  # its advice on batches
        # A gamma of 1e12 overflows; numpy's own lines are those of a variance.
        warnings.filterwarnings("ignore", category=RuntimeWarning, module=r"stable_baselines3|numpy\._core\._methods")
        outcome, why = attempt(lambda: train_config(shortened(resolved(folder, **case)), folder / "run"), named)
    if outcome == "works" and warned:
        return "failed", f"{warned[0].category.__name__} at {warned[0].filename}:{warned[0].lineno}"
    return outcome, why


def resolved(folder: Path, settings: Any, agent: Any = None, task: Any = None, pairs: Any = (), preset: Any = None):
    if preset is not None:
        (folder / "mine.yaml").write_bytes(preset)
        preset = str(folder / "mine.yaml")
    return resolve(agent, task, preset, {**settings, **parse_settings(pairs)})


def shortened(config: Config) -> Config:
    train = {key: min(getattr(config.train, key), most) for key, most in LONG_TRAINING.items()}
    agent = dict(config.agent_arguments)
    for key, most in LONG_ALGORITHM.items():
        if isinstance(agent.get(key), int):
            agent[key] = min(agent[key], most)
        elif isinstance(agent.get(key), list | tuple) and agent[key] and isinstance(agent[key][0], int):
            agent[key] = (min(agent[key][0], most), *agent[key][1:])
    return dataclasses.replace(config, agent_arguments=agent, train=dataclasses.replace(config.train, **train))


def load_damaged(folder: Path, runs: Path, number: int) -> tuple[str, str]:
    """Load a checkpoint with damage number `number`, and resume a run with it."""
    agent, content = damaged(runs, number)
    run = Path(shutil.copytree(runs / agent, folder / "run"))
    (file,) = run.glob("checkpoints/*")
    file.write_bytes(content)
    outcome, why = attempt(lambda: load(file), [str(run)])
    if outcome != "failed":
        outcome, why = attempt(lambda: resume(run), [str(run)])
        for thread in threading.enumerate():  # a failed training leaves threads that write event files
            if hasattr(thread, "stop"):
                thread.stop()
    return outcome, f"{agent}, damage {number}: {why}"


def main() -> None:
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    small = {"train.simulation": "kinematic", "train.n_envs": 2, "train.eval_freq": 0, "train.total_timesteps": STEPS}
    with tempfile.TemporaryDirectory() as folder:  # imports do not count
        train_with(Path(folder), [""], agent="ppo", settings={**small, "agent.n_steps": 4, "agent.batch_size": 4})
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    print("ready", file=answers)
    while True:
        try:
            case = pickle.load(sys.stdin.buffer)
        except EOFError:
            break
        with tempfile.TemporaryDirectory() as folder:
            function = load_damaged if "runs" in case else train_with
            print(json.dumps(function(Path(folder), **case)), file=answers)


if __name__ == "__main__":
    main()
