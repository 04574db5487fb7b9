"""Training rates of PPO and SAC: tb2rl, Stable-Baselines3 alone, SBX and single files as CleanRL's, on one processor.

    python docs/benchmark/rates.py

All train task `drive` in the kinematic simulator with the same laser, networks of two layers of 64 units, and the
parameters below. Each training is its own process. The rate is steps over wall time without the first tenth, in which
programs compile. Programs take turns. The page is `rates.md`. SBX is not a dependency: `pip install sbx-rl`.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any

from peers import PpoParameters, train_ppo
from sac import SacParameters, train_sac
from stable_baselines3.common.callbacks import BaseCallback

from tb2rl.commands.benchmark import describe_machine
from tb2rl.core import write_text
from tb2rl.core.command import ArgumentParser, between, report_errors
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.runs import resolve
from tb2rl.training.training import train_config

FOLDER = Path(__file__).parent
TASK, HIDDEN, ROUNDS = "drive", [64, 64], 3
PPO = PpoParameters(num_envs=256, num_steps=64, batch_size=2_048, epochs=5, learning_rate=3e-4, entropy_weight=0.0)
SAC = SacParameters(num_envs=64, updates=4, batch_size=256, buffer_size=100_000, learning_starts=2_000, hidden=64)
STEPS = {"PPO": 400_000, "SAC": 30_000}  # of a training
PACKAGES = {"tb2rl": ["tb2rl"], "Stable-Baselines3": ["stable-baselines3"], "SBX": ["sbx-rl", "jax"]}
INTRODUCTION = f"""# Training rates

Steps of the environment per second of wall time, in trainings at task `{TASK}` with the same laser in the kinematic
simulator: tb2rl as `python -m tb2rl.train` runs it, Stable-Baselines3 and SBX in the same vectorised environment, and
single files after CleanRL's ([peers.py](peers.py), [sac.py](sac.py)). Median of trainings that took turns, in brackets
the least and the largest rate. Written by `python docs/benchmark/rates.py`; SBX needs `pip install sbx-rl`.

All have networks of two layers of 64 units. PPO: {PPO.num_envs} environments, rollouts of {PPO.num_steps} steps,
batches of {PPO.batch_size:,}, {PPO.epochs} epochs. SAC: {SAC.num_envs} environments, {SAC.updates} updates after each
of their steps, batches of {SAC.batch_size}.
"""


class Rate(BaseCallback):
    """Measures the rate of a training without its first tenth."""

    def __init__(self, total_timesteps: int) -> None:
        super().__init__()
        self._first, self._mark = total_timesteps // 10, None

    def goes_on(self, timesteps: int) -> bool:
        """Begin to measure when there have been enough steps; the training goes on."""
        if self._mark is None and timesteps >= self._first:
            self._mark = timesteps, time.perf_counter()
        return True

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self.goes_on(self.model.num_timesteps)

    def value(self, timesteps: int) -> float:
        """Steps per second, at the end of a training."""
        assert self._mark is not None
        return (timesteps - self._mark[0]) / (time.perf_counter() - self._mark[1])


def main(arguments: list[str] | None = None) -> None:
    """Measure all programs, and write the page; with --one, print the rate of one program."""
    parser = ArgumentParser(prog="python docs/benchmark/rates.py", description=str(__doc__).splitlines()[0])
    parser.add_argument("--rounds", type=between(1, 100), default=ROUNDS, help=f"trainings of each program ({ROUNDS})")
    parser.add_argument("--share", type=between(1e-3, 1.0, float), default=1.0, help="share of the steps")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="folder of the page")
    parser.add_argument("--one", nargs=2, metavar=("PROGRAM", "ALGORITHM"), help=argparse.SUPPRESS)
    with report_errors():
        options = parser.parse_args(arguments)
        if options.one:
            program, algorithm = options.one
            steps = round(options.share * STEPS[algorithm])
            rate = Rate(steps)
            print(rate.value(PROGRAMS[program](algorithm, steps, rate)))
        else:
            print(write_page(options.folder, measure_all(options.rounds, options.share)))


def measure_all(rounds: int, share: float) -> dict[tuple[str, str], list[float]]:
    """Rates [steps/s] by program and algorithm."""
    rates: dict[tuple[str, str], list[float]] = {}
    programs = [name for name in PROGRAMS if name != "SBX" or find_spec("sbx")]
    for number in range(rounds):
        for algorithm in STEPS:
            for program in programs:
                command = [sys.executable, str(Path(__file__)), "--share", str(share), "--one", program, algorithm]
                output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
                rate = float(output.splitlines()[-1])
                rates.setdefault((program, algorithm), []).append(rate)
                print(f"round {number + 1}: {program} {algorithm} {rate:,.0f} steps/s", flush=True)
    return rates


def train_ours(algorithm: str, steps: int, rate: Rate) -> int:
    """Train as `python -m tb2rl.train` does, without evaluations."""
    if algorithm == "PPO":
        parameters = {"n_steps": PPO.num_steps, "batch_size": PPO.batch_size, "n_epochs": PPO.epochs}
        num_envs = PPO.num_envs
    else:
        parameters, num_envs = {**_sac_parameters(), "ent_coef": "auto"}, SAC.num_envs
    settings: dict[str, Any] = {f"agent.{key}": value for key, value in parameters.items()}
    settings["agent.policy_kwargs.net_arch"] = HIDDEN
    train = {"simulation": "kinematic", "n_envs": num_envs, "total_timesteps": steps, "eval_freq": 0, "save_freq": 0}
    settings |= {f"train.{key}": value for key, value in train.items()}
    config = resolve(algorithm.lower(), TASK, None, settings | {"train.episodes": None, "train.stop_score": None})
    with tempfile.TemporaryDirectory() as folder:
        return train_config(config, Path(folder) / "run", watchers=[rate]).timesteps


def train_library(module: str, algorithm: str, steps: int, rate: Rate) -> int:
    """Train with Stable-Baselines3 or SBX in our vectorised environment."""
    scene = make_scene(make_task(TASK, {"beams": _beams()}), "raw")
    num_envs = PPO.num_envs if algorithm == "PPO" else SAC.num_envs
    env = TurtleBot2VecEnv(scene, num_envs, simulation="kinematic")
    ppo = {"n_steps": PPO.num_steps, "batch_size": PPO.batch_size, "n_epochs": PPO.epochs}
    parameters = ppo if algorithm == "PPO" else _sac_parameters()
    learner = getattr(import_module(module), algorithm)
    model = learner("MlpPolicy", env, policy_kwargs={"net_arch": HIDDEN}, seed=0, **parameters)
    model.learn(steps, callback=rate)
    env.close()
    return model.num_timesteps


def train_single_file(algorithm: str, steps: int, rate: Rate) -> int:
    """Train with a single file after CleanRL's."""
    if algorithm == "PPO":
        return train_ppo(TASK, 0, steps, rate.goes_on, PPO, beams=_beams()).timesteps
    return train_sac(TASK, 0, steps, rate.goes_on, SAC, beams=_beams())


def _beams() -> int:
    return resolve("ppo", TASK).task.beams


def _sac_parameters() -> dict[str, Any]:
    names = {"batch_size": SAC.batch_size, "buffer_size": SAC.buffer_size, "learning_starts": SAC.learning_starts}
    return {**names, "train_freq": 1, "gradient_steps": SAC.updates}


PROGRAMS: dict[str, Callable[[str, int, Rate], int]] = {
    "tb2rl": train_ours,
    "Stable-Baselines3": lambda *arguments: train_library("stable_baselines3", *arguments),
    "SBX": lambda *arguments: train_library("sbx", *arguments),
    "CleanRL-style": train_single_file,
}


def write_page(folder: Path, rates: dict[tuple[str, str], list[float]]) -> Path:
    """Write the page."""
    lines = ["| | version | " + " | ".join(f"{algorithm}, steps/s" for algorithm in STEPS) + " |"]
    lines.append("|---|---|" + "---|" * len(STEPS))
    for program in dict.fromkeys(name for name, _ in rates):
        versions = ", ".join(f"{package} {version(package)}" for package in PACKAGES.get(program, ["torch"]))
        cells = [_cell(rates[program, algorithm]) for algorithm in STEPS]
        lines.append(f"| {program} | {versions} | {' | '.join(cells)} |")
    machine = f"Machine: {describe_machine()}, torch {version('torch')}."
    page = folder / "rates.md"
    write_text(page, "\n".join([INTRODUCTION, *lines, "", machine, ""]))
    return page


def _cell(rates: list[float]) -> str:
    """Median, and in brackets the least and the largest rate, with three digits."""
    return "{} ({} to {})".format(*(f"{float(f'{rate:.3g}'):,.0f}" for rate in (median(rates), min(rates), max(rates))))


if __name__ == "__main__":
    main()
