"""Selects the best trial in physics, and compares its settings with the default settings.

To avoid selection bias, the episodes of the selection differ from those of all reports: they have other start poses
and, if worlds are generated, other worlds. The comparison trains with fresh seeds, and uses the standard evaluation.
"""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from optuna.trial import FrozenTrial

from tb2rl.core.files import read_text, write_text
from tb2rl.evaluation.evaluate import Evaluator, evaluate, random_initial_states
from tb2rl.evaluation.evaluation import load_evaluation
from tb2rl.evaluation.statistics import bootstrap_interval, wilson_interval
from tb2rl.runs import Config, Run, load
from tb2rl.simulation import find_simulator
from tb2rl.training.training import train_config
from tb2rl.tuning.study import FRESH_SEED, StudyFolder

NUM_SELECTED = 3  # number of trials with the highest scores that are evaluated in physics
_EPISODES = 100  # number of episodes per trial, divided among the policies of the trial's seeds
_SEED = 20_210_000  # seed of the episodes of a trial's first policy


@dataclass(frozen=True)
class TrialEvaluation:
    """Evaluation of the policies of a trial in the default simulator for evaluations, see `default_simulator`."""

    trial: int  # number of the trial
    good: int  # number of good episodes
    episodes: int
    mean_return: float
    simulation: str

    @property
    def good_rate(self) -> float:
        return self.good / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the rate."""
        return wilson_interval(self.good, self.episodes)

    @property
    def simulator(self) -> str:
        """Title of the simulator."""
        return find_simulator(self.simulation).title


def evaluate_trial(folder: StudyFolder, trial: FrozenTrial) -> TrialEvaluation:
    """Evaluate the policies of a trial, or read the existing evaluation."""
    trial_folder = folder.trial_folder(trial.number)
    file, evaluations = trial_folder / "evaluation.json", []
    if file.is_file():
        return TrialEvaluation(**json.loads(read_text(file)))
    config = folder.config(folder.settings(trial.params))
    scene, num_episodes = config.scene.for_purpose("search"), -(-_EPISODES // len(folder.seeds))
    for i, training_seed in enumerate(folder.seeds):
        seed = _SEED + i * num_episodes
        states = random_initial_states(scene, num_episodes, seed)
        with Evaluator(scene, states, config.train.eval_steps, seed) as evaluator:
            evaluations.append(evaluator.run(load(trial_folder / f"seed-{training_seed}").policy, progress_bar=True))
    good = sum(round(num_episodes * evaluation.good_rate) for evaluation in evaluations)
    mean_return = sum(evaluation.score[1] for evaluation in evaluations) / len(evaluations)
    total = num_episodes * len(evaluations)
    result = TrialEvaluation(trial.number, good, total, mean_return, evaluator.simulator.name)
    write_text(file, json.dumps(asdict(result)) + "\n")
    return result


def select_best(evaluations: Sequence[TrialEvaluation], best_by: str) -> TrialEvaluation:
    """Select the best evaluation; the first one wins a tie, because evaluations are sorted by score."""
    return max(evaluations, key=lambda result: result.mean_return if best_by == "return" else result.good_rate)


@dataclass(frozen=True)
class Comparison:
    """One side of the comparison: results of trainings with the same settings and fresh seeds.

    Attributes:
        name: Name of the settings.
        rates: Rate of good episodes of each training.
        summaries: Summaries of the standard evaluations, by seed.
    """

    name: str
    rates: Sequence[float]
    summaries: Mapping[int, Mapping[str, Any]]

    @property
    def mean(self) -> float:
        """Mean rate of good episodes."""
        return sum(self.rates) / len(self.rates)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % bootstrap interval of the mean over trainings."""
        return bootstrap_interval(self.rates)


def compare(folder: StudyFolder, name: str, settings: Mapping[str, Any], num_seeds: int) -> Comparison:
    """Train and evaluate one side of the comparison with fresh seeds; runs that are evaluated already are only read.

    Args:
        folder: Folder of the study, which will contain the run folders.
        name: Name of the settings.
        settings: Settings by dotted key that override the default ones.
        num_seeds: Number of trainings.
    """
    parent, evaluations = folder.path / "fresh" / name.replace(" ", "-"), {}
    for seed in range(FRESH_SEED, FRESH_SEED + num_seeds):
        evaluations[seed] = load_evaluation(_evaluated_run(folder.config(settings, seed), parent / f"seed-{seed}"))
    rates = [evaluation.good_rate for evaluation in evaluations.values()]
    return Comparison(name, rates, {seed: evaluation.summary() for seed, evaluation in evaluations.items()})


def _evaluated_run(config: Config, folder: Path) -> Run:
    if (folder / "config.yaml").is_file() and (run := Run.open(folder)).has_evaluation_episodes:
        return run
    shutil.rmtree(folder, ignore_errors=True)
    training = train_config(config, folder)
    if training.signal_number:
        raise KeyboardInterrupt
    evaluation = evaluate(load(folder), progress_bar=True)
    training.run.write_evaluation(*evaluation.serialize(config, str(folder)))
    return training.run
