"""Selection of the best trial in PyBullet, and a comparison of its settings with the default ones.

Selection and report use different episodes: the selection has start poses, and worlds if they are generated, that no
report uses. The comparison trains with seeds that no trial had, and uses the standard evaluation.
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
from tb2rl.simulation import find_simulator
from tb2rl.training.training import train_config
from tb2rl.tuning.study import FRESH_SEED, StudyFolder

SELECTED = 3  # trials of the highest scores
_EPISODES = 100  # of a trial, shared by the policies of its seeds
_SEED = 20_210_000  # of their start poses


@dataclass(frozen=True)
class TrialEvaluation:
    """Evaluation of a trial's policies in PyBullet, or in the kinematic simulator if PyBullet is missing."""

    trial: int
    good: int  # episodes
    episodes: int
    mean_return: float
    simulation: str

    @property
    def good_rate(self) -> float:
        """Share of good episodes."""
        return self.good / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the share."""
        return wilson_interval(self.good, self.episodes)

    @property
    def simulator(self) -> str:
        """Name of the simulator in a sentence."""
        return find_simulator(self.simulation).title


def evaluate_trial(folder: StudyFolder, trial: FrozenTrial) -> TrialEvaluation:
    """Evaluate the policies of a trial, or read the evaluation if it exists."""
    file = folder.trial_folder(trial.number) / "evaluation.json"
    if file.is_file():
        return TrialEvaluation(**json.loads(read_text(file)))
    config = folder.config(folder.settings(trial.params))
    scene, each = config.scene.worlds_for("search"), -(-_EPISODES // len(folder.seeds))
    good, total = 0, 0.0
    for number, seed in enumerate(folder.seeds):
        first = _SEED + number * each
        states = random_initial_states(scene, each, first)
        with Evaluator(scene, states, config.train.eval_steps, first) as evaluator:
            evaluation = evaluator.run(load(folder.run_folder(trial.number, seed)).policy, progress=True)
        good += round(each * evaluation.good_rate)
        total += evaluation.score[1]
    episodes = each * len(folder.seeds)
    result = TrialEvaluation(trial.number, good, episodes, total / len(folder.seeds), evaluator.simulator.name)
    write_text(file, json.dumps(asdict(result)) + "\n")
    return result


def select_best(evaluations: Sequence[TrialEvaluation], best_by: str) -> TrialEvaluation:
    """The best evaluation; of equal ones the first, whose trial has the higher score."""
    return max(evaluations, key=lambda each: each.mean_return if best_by == "return" else each.good_rate)


@dataclass(frozen=True)
class FreshRun:
    """The standard evaluation of a training with a fresh seed."""

    seed: int
    rate: float  # share of good episodes
    interval: tuple[float, float]
    distance: float  # [m] mean of an episode
    speed: float  # [m/s]


@dataclass(frozen=True)
class Comparison:
    """Trainings with the same settings and fresh seeds."""

    name: str
    runs: Sequence[FreshRun]

    @property
    def rates(self) -> list[float]:
        """Share of good episodes of each."""
        return [run.rate for run in self.runs]

    @property
    def mean(self) -> float:
        """Mean share of good episodes."""
        return sum(self.rates) / len(self.rates)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % bootstrap interval of the mean, over the trainings."""
        return bootstrap_interval(self.rates)


def compare(folder: StudyFolder, name: str, settings: Mapping[str, Any], seeds: int) -> Comparison:
    """Train with fresh seeds and evaluate, or read the runs that exist.

    Args:
        folder: Of the study; it gets the run folders.
        name: Of the settings.
        settings: By dotted key, over the default ones.
        seeds: How many.
    """
    runs = []
    for seed in range(FRESH_SEED, FRESH_SEED + seeds):
        run = _train(folder.config(settings, seed), folder.path / "fresh" / name.replace(" ", "-") / f"seed-{seed}")
        evaluation = kept_evaluation(run)
        rate, episodes, summary = evaluation.good_rate, len(evaluation.episodes), evaluation.summary()
        interval = wilson_interval(round(rate * episodes), episodes)
        runs.append(FreshRun(seed, rate, interval, summary["mean_distance"], summary["mean_speed"]))
    return Comparison(name, runs)


def _train(config: Config, folder: Path) -> Run:
    if (folder / "config.yaml").is_file() and (run := Run.open(folder)).has_evaluation:
        return run
    shutil.rmtree(folder, ignore_errors=True)
    training = train_config(config, folder)
    if training.interrupted:
        raise KeyboardInterrupt
    evaluation = evaluate(load(folder), progress=True)
    training.run.write_evaluation(*evaluation.tree(config, str(folder)))
    return training.run
