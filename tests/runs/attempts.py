"""Trains for a few steps with settings that come in, in a process that may hang or run out of memory.

It reads pickled cases from its standard input (see `test_any_setting.py`) and answers each with a line of JSON: what is
wrong with how it went, "" if nothing is.
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
MEMORY = 4 * 2**30  # [bytes] of address space that the cases of a process may take

# What is allowed and only takes long is cut after it has been checked; allocations are not.
LONG_TRAINING = {"total_timesteps": STEPS, "eval_steps": STEPS}
LONG_ALGORITHM = {"n_epochs": 2, "gradient_steps": 2, "train_freq": STEPS}


def attempt(case: dict[str, Any]) -> str:
    """What is wrong with how a case goes."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        warnings.filterwarnings("ignore", category=UserWarning, module="stable_baselines3")  # its advice on batches
        # A gamma of 1e12 is nonsense, and what is calculated from it, too; numpy's own lines are those of a variance.
        warnings.filterwarnings("ignore", category=RuntimeWarning, module=r"stable_baselines3|numpy\._core\._methods")
        try:
            train_config(short(asked(case, Path(folder))), Path(folder, "run"))
        except InputError as error:
            message = str(error)
            if "\n" in message:
                return f"a message of several lines: {message!r}"
            named = any(name in message.lower() for name in case["named"])
            return "" if named else f"a message without the key: {message}"
        except BaseException as error:
            return f"{type(error).__name__} at {places(error)}: {error}"
        return "".join(
            f"{w.category.__name__} at {Path(w.filename).name}:{w.lineno}: {w.message}; " for w in warned[:1]
        )


def asked(case: dict[str, Any], folder: Path) -> Config:
    preset = case.get("preset")
    if "file" in case:
        preset = str(folder / "mine.yaml")
        Path(preset).write_bytes(case["file"])
    settings = {**case.get("settings", {}), **parse_settings(case.get("pairs", []))}
    return resolve(case.get("agent"), case.get("task"), preset, settings)


def short(config: Config) -> Config:
    train = {key: min(getattr(config.train, key), most) for key, most in LONG_TRAINING.items()}
    agent = dict(config.agent_arguments)
    for key, most in LONG_ALGORITHM.items():
        if isinstance(agent.get(key), int):
            agent[key] = min(agent[key], most)
        elif isinstance(agent.get(key), list | tuple) and agent[key] and isinstance(agent[key][0], int):
            agent[key] = (min(agent[key][0], most), *agent[key][1:])
    return dataclasses.replace(config, agent_arguments=agent, train=dataclasses.replace(config.train, **train))


def places(error: BaseException) -> str:
    """Where an exception was raised, and the last lines of the project on the way there."""
    frame_stack = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frame_stack if "/tb2rl/" in frame.filename or "/agents/" in frame.filename]
    found = [f"{Path(frame.filename).name}:{frame.lineno}" for frame in (frame_stack[-1], *reversed(ours[-2:]))]
    return " < ".join(dict.fromkeys(found))


def main() -> None:
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    train = {"total_timesteps": STEPS, "simulation": "kinematic", "n_envs": 2, "eval_freq": 0}
    settings = {f"train.{key}": value for key, value in train.items()} | {"agent.n_steps": 4, "agent.batch_size": 4}
    attempt({"agent": "ppo", "settings": settings, "named": [""]})  # its imports take more than a case may
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
