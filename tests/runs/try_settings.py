"""Trains for a few steps with given settings, in a process that may hang or exhaust memory.

Reads pickled cases from stdin (see `test_any_value.py`) and answers each with a line of JSON: a failure, or "".
"""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import resource
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError
from tb2rl.runs.config import Config
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.training.training import train_config

STEPS = 8
MEMORY = 4 * 2**30  # [bytes] of address space for the cases of a process

# Long trainings are shortened after their settings have been checked; allocations are not.
LONG_TRAINING = {"total_timesteps": STEPS, "eval_steps": STEPS}
LONG_ALGORITHM = {"n_epochs": 2, "gradient_steps": 2, "train_freq": STEPS}


def attempt(case: dict[str, Any]) -> str:
    """The failure of a case: neither trained without a warning, nor refused in one line that names its key."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        warnings.filterwarnings("ignore", category=UserWarning, module="stable_baselines3")  # its advice on batches
        # A gamma of 1e12 overflows; numpy's own lines are those of a variance.
        warnings.filterwarnings("ignore", category=RuntimeWarning, module=r"stable_baselines3|numpy\._core\._methods")
        try:
            train_config(shortened(resolved(case, Path(folder))), Path(folder, "run"))
        except InputError as error:
            message = str(error)
            if "\n" in message:
                return f"a message of several lines: {message!r}"
            named = any(name in message.lower() for name in case["named"])
            return "" if named else f"a message without the key: {message}"
        except BaseException as error:
            frames = traceback.extract_tb(error.__traceback__)[-3:]
            places = " > ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in frames)
            return f"{type(error).__name__} at {places}: {error}"
        return "".join(f"{w.category.__name__} at {w.filename}:{w.lineno}: {w.message}" for w in warned[:1])


def resolved(case: dict[str, Any], folder: Path) -> Config:
    preset = None
    if "file" in case:
        preset = str(folder / "mine.yaml")
        Path(preset).write_bytes(case["file"])
    settings = {**case.get("settings", {}), **parse_settings(case.get("pairs", []))}
    return resolve(case.get("agent"), case.get("task"), preset, settings)


def shortened(config: Config) -> Config:
    train = {key: min(getattr(config.train, key), most) for key, most in LONG_TRAINING.items()}
    agent = dict(config.agent_arguments)
    for key, most in LONG_ALGORITHM.items():
        if isinstance(agent.get(key), int):
            agent[key] = min(agent[key], most)
        elif isinstance(agent.get(key), list | tuple) and agent[key] and isinstance(agent[key][0], int):
            agent[key] = (min(agent[key][0], most), *agent[key][1:])
    return dataclasses.replace(config, agent_arguments=agent, train=dataclasses.replace(config.train, **train))


def main() -> None:
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    train = {"total_timesteps": STEPS, "simulation": "kinematic", "n_envs": 2, "eval_freq": 0}
    settings = {f"train.{key}": value for key, value in train.items()} | {"agent.n_steps": 4, "agent.batch_size": 4}
    attempt({"agent": "ppo", "settings": settings, "named": [""]})  # imports do not count
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    print(json.dumps("ready"), file=answers)
    while True:
        try:
            case = pickle.load(sys.stdin.buffer)
        except EOFError:
            break
        print(json.dumps(attempt(case)), file=answers)


if __name__ == "__main__":
    main()
