"""How good the best settings really are: the policies of the best trials in PyBullet, then new ones beside the default.

Choosing and reporting are kept apart. Which of the best trials is best is said by start poses, and worlds if they are
generated, that no report uses. The trainings afterwards have seeds that no trial had, and the standard evaluation.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from optuna.trial import FrozenTrial

from tb2rl.core.files import read_text, write_text
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import kept_evaluation
from tb2rl.evaluation.evaluator import Evaluator, random_initial_states
from tb2rl.evaluation.statistics import bootstrap_interval, wilson_interval
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load
from tb2rl.training.training import train_config
from tb2rl.tuning.study import FRESH_SEED, Search

JUDGED = 3  # of the best trials
_EPISODES = 100  # of a trial, shared by the policies of its seeds
_SEED = 20_210_000  # of their start poses


@dataclass(frozen=True)
class Judgement:
    """What the policies of a trial did in PyBullet, or in the twin where it is missing."""

    trial: int
    good: int  # episodes
    episodes: int
    mean_return: float
    simulation: str

    @property
    def good_rate(self) -> float:
        """The share of good episodes."""
        return self.good / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share of good episodes, with 95 % confidence."""
        return wilson_interval(self.good, self.episodes)


def judge(search: Search, trial: FrozenTrial) -> Judgement:
    """Drive the policies of a trial, unless that was done before."""
    file = search.trial_folder(trial.number) / "judged.json"
    if file.is_file():
        return Judgement(**json.loads(read_text(file)))
    config = search.config(search.settings(trial.params))
    scene, each = config.scene.worlds_for("search"), -(-_EPISODES // len(search.seeds))
    good, total = 0, 0.0
    for number, seed in enumerate(search.seeds):
        first = _SEED + number * each
        states = random_initial_states(scene, each, first)
        with Evaluator(scene, states, config.train.eval_steps, first) as evaluator:
            evaluation = evaluator.run(load(search.run_folder(trial.number, seed)).policy, progress=True)
        good += round(each * evaluation.good_rate)
        total += evaluation.score[1]
    judgement = Judgement(
        trial.number, good, each * len(search.seeds), total / len(search.seeds), evaluator.simulator.name
    )
    write_text(file, json.dumps(asdict(judgement)) + "\n")
    return judgement


def best_of(judgements: Sequence[Judgement], best_by: str) -> Judgement:
    """The best of some judgements; of equal ones the first, which is that of the better trial in the twin."""
    return max(judgements, key=lambda each: each.mean_return if best_by == "return" else each.good_rate)


@dataclass(frozen=True)
class Comparison:
    """The standard evaluation of trainings with some settings, one for each of several seeds."""

    name: str
    seeds: Sequence[int]
    rates: Sequence[float]  # share of good episodes of each
    intervals: Sequence[tuple[float, float]]
    distances: Sequence[float]  # [m] mean of each
    speeds: Sequence[float]  # [m/s]

    @property
    def mean(self) -> float:
        """The mean share of good episodes."""
        return sum(self.rates) / len(self.rates)

    @property
    def interval(self) -> tuple[float, float]:
        """Of that mean, over the trainings."""
        return bootstrap_interval(self.rates)


def compare(search: Search, name: str, settings: Mapping[str, Any], seeds: int) -> Comparison:
    """Train with settings and fresh seeds, and drive the standard evaluation, unless that was done before.

    Args:
        search: The study, whose folder gets the run folders.
        name: Of the settings.
        settings: By dotted key, over the default ones.
        seeds: How many.
    """
    numbers = [FRESH_SEED + i for i in range(seeds)]
    runs = [_fresh(search.config(settings, seed), search.folder / "fresh" / name / f"seed-{seed}") for seed in numbers]
    evaluations = [kept_evaluation(run) for run in runs]
    rates, summaries = [each.good_rate for each in evaluations], [each.summary() for each in evaluations]
    counts = [
        (round(rate * len(each.episodes)), len(each.episodes)) for rate, each in zip(rates, evaluations, strict=True)
    ]
    return Comparison(
        name,
        numbers,
        rates,
        [wilson_interval(*count) for count in counts],
        [summary["mean_distance"] for summary in summaries],
        [summary["mean_speed"] for summary in summaries],
    )


def _fresh(config: Config, folder: Path) -> Run:
    """The run of a training that is there, or is made now."""
    if (folder / "config.yaml").is_file() and (run := Run.open(folder)).has_evaluation:
        return run
    shutil.rmtree(folder, ignore_errors=True)
    training = train_config(config, folder)
    if training.interrupted:
        raise KeyboardInterrupt
    evaluation = evaluate(load(folder), progress=True)
    training.run.write_evaluation(*evaluation.tree(config, str(folder)))
    return training.run
