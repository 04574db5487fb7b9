"""Benchmark of learning: each agent at each task that it can learn, ten seeds each, beside rules and other programs.

    python docs/benchmark/run.py
    python docs/benchmark/run.py --on ray:10.0.0.1:6379

A training takes 30 s of one processor core, without its evaluations. The steps that this allows are counted once, in a
pilot training; all seeds then train for as many steps, so that a training can be repeated exactly. Other programs have
five seeds, and three of each pair are judged in physics, too. Results are the
lines of `runs.jsonl`, to which the same command adds those that are missing, and the page `README.md`.
"""

import argparse
import json
import math
import tempfile
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

from page import EPISODES, SECONDS, write_page
from pairs import PILOT, Pair, find_config, find_pairs, is_rule
from peers import Trained, entrants
from stable_baselines3.common.callbacks import BaseCallback

from tb2rl.commands.benchmark import describe_machine
from tb2rl.core import agent_names
from tb2rl.core.command import ArgumentParser, between, report_errors
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.metrics import criterion
from tb2rl.execution.arguments import add_executor_arguments, make_executor
from tb2rl.execution.executor import Job
from tb2rl.runs import TRAINING_EVALUATIONS, load, make_baseline, read_lines
from tb2rl.simulation.simulator import default_physics
from tb2rl.training.training import train_config

FOLDER = Path(__file__).parent
SEEDS, OTHER_SEEDS, PHYSICS_SEEDS = 10, 5, 3  # of agents, at most of other programs, and judged in physics
CURVE_POINTS = 10
# Limits of a pilot training; other programs explore for a share of the total.
MANY_STEPS, PEER_STEPS = 10**9, 250_000
Row = dict[str, Any]  # a line of the file: name, task, seed, and what was measured


def main(arguments: list[str] | None = None) -> None:
    """Run what the command line selects."""
    parser = ArgumentParser(prog="python docs/benchmark/run.py", description=str(__doc__).splitlines()[0])
    parser.add_argument("--seeds", type=between(1, 1000), default=SEEDS, help=f"trainings of each pair ({SEEDS})")
    parser.add_argument(
        "--seconds", type=between(1e-3, 1e6, float), default=SECONDS, help=f"CPU time of a training ({SECONDS})"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help="agents, tasks or programs (default: all)")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="folder of runs.jsonl and the page")
    add_executor_arguments(parser)
    with report_errors():
        run(parser.parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Run what is missing, and write the page."""
    file = options.folder / "runs.jsonl"
    rows = read_lines(file) if file.exists() else []
    machine = describe_machine()
    pairs = [pair for pair in find_pairs() if not options.only or not {*pair}.isdisjoint(options.only)]
    with make_executor(options) as executor, file.open("a", encoding="utf-8", newline="\n") as lines:
        for jobs in (pilots, trainings):
            todo = list(jobs(pairs, rows, options))
            for number, (job, row) in enumerate(executor.as_completed(measure, todo), 1):
                rows.append(row := row | ({"machine": machine} if row["seed"] == PILOT else {}))
                lines.write(json.dumps(row) + "\n")
                lines.flush()
                print(f"{number} of {len(todo)}: {job.name}", flush=True)
    print(write_page(options.folder, rows))


def pilots(pairs: list[Pair], rows: list[Row], options: argparse.Namespace) -> Iterator[Job]:
    """Jobs that count the steps of a training."""
    have = {(row["name"], row["task"]) for row in rows if row["seed"] == PILOT}
    for name, task in pairs:
        if not is_rule(name) and (name, task) not in have:
            yield Job(f"{name} at {task}, pilot", (name, task, PILOT, None, options.seconds))


def trainings(pairs: list[Pair], rows: list[Row], options: argparse.Namespace) -> Iterator[Job]:
    """Jobs that train and evaluate; a rule is only evaluated."""
    have = {(row["name"], row["task"], row["seed"]) for row in rows}
    steps = {(row["name"], row["task"]): row["timesteps"] for row in rows if row["seed"] == PILOT}
    for seed, (name, task) in product(range(options.seeds), pairs):
        num_seeds = 1 if is_rule(name) else options.seeds if name in agent_names() else min(options.seeds, OTHER_SEEDS)
        if (name, task, seed) not in have and seed < num_seeds:
            yield Job(f"{name} at {task}, seed {seed}", (name, task, seed, steps.get((name, task)), None))


def measure(name: str, task: str, seed: int, steps: int | None, seconds: float | None) -> Row:
    """Train for `steps` and evaluate, or count the steps that `seconds` allow."""
    others, limit = entrants(), Limit(seconds)
    with tempfile.TemporaryDirectory() as folder:
        if is_rule(name):
            config = find_config(name, task)
            trained, arguments = Trained(make_baseline(config), 0), {"config": config}
        elif (name, task) in others:
            trained = others[name, task](task, max(seed, 0), steps or PEER_STEPS, limit.goes_on)
            arguments = {"task": task, "observation": "raw"}
        else:
            trained, arguments = train_agent(name, task, seed, steps, limit, Path(folder)), {}
        row = {"name": name, "task": task, "seed": seed, "timesteps": trained.timesteps}
        if seed == PILOT:
            share = min(1.0, limit.elapsed() / seconds)  # of the time, if the training was over sooner
            return {**row, "timesteps": _rounded(trained.timesteps / share)}
        results = {}
        for simulation in ("kinematic", default_physics().name)[: 2 if seed < PHYSICS_SEEDS else 1]:
            conditions = {"simulation": simulation, "episodes": EPISODES, "workers": 1}
            evaluation = evaluate(trained.policy, **conditions, **arguments)
            squares = evaluation.summary()["median_squares"]
            results[simulation] = {"good": int(evaluation.good.sum()), "squares": squares}
    return {**row, "results": results, "curve": trained.curve}


class Limit(BaseCallback):
    """Ends a training after some CPU time of this process [s], which other processes do not lengthen.

    Time passes from the first step on; None: no limit.
    """

    def __init__(self, seconds: float | None) -> None:
        super().__init__()
        self._seconds, self._start = seconds, math.nan

    def elapsed(self) -> float:
        """CPU time since the first step [s]."""
        return time.process_time() - self._start

    def goes_on(self, timesteps: int) -> bool:
        """Whether there is time left."""
        if math.isnan(self._start):
            self._start = time.process_time()
        return self._seconds is None or self.elapsed() < self._seconds

    def _on_step(self) -> bool:
        return self.goes_on(self.num_timesteps)


def train_agent(name: str, task: str, seed: int, steps: int | None, limit: Limit, folder: Path) -> Trained:
    """Train one of our agents; its policy is the best of its evaluations, which have other starts than the result."""
    common = {"seed": max(seed, 0), "save_freq": 0, "stop_score": None, "episodes": None, "eval_episodes": EPISODES}
    if steps is None:
        common["eval_freq"] = 0
        train_config(find_config(name, task, **common, total_timesteps=1), folder / "warm-up")
    else:
        common["eval_freq"] = max(1, steps // CURVE_POINTS)
    config = find_config(name, task, **common, total_timesteps=steps or MANY_STEPS)
    finished = train_config(config, folder / "run", watchers=[limit])
    if steps is None:
        return Trained(None, finished.timesteps)
    key = criterion(config.task.goal_task).key
    lines = read_lines(finished.run.folder / TRAINING_EVALUATIONS)
    curve = [(line["timesteps"], round(line[key], 4)) for line in lines]
    return Trained(load(finished.run.folder), finished.timesteps, curve)


def _rounded(steps: float) -> int:
    """Steps with two significant digits."""
    return int(float(f"{steps:.1e}"))


if __name__ == "__main__":
    main()
