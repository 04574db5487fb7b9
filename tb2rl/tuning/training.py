"""The trainings of a trial, in a worker; workers see neither the study's database nor its folder."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna import Study, Trial, TrialPruned
from optuna.trial import FrozenTrial, TrialState, create_trial

from tb2rl.core.errors import InputError, UnwritableError
from tb2rl.envs.worlds import carry
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs.config import Config
from tb2rl.runs.loading import load
from tb2rl.training.environments import make_evaluator
from tb2rl.training.training import train_config
from tb2rl.tuning.storage import count_evaluations, make_pruner
from tb2rl.tuning.study import StudyFolder, StudyOptions

SCORE_SEED = 20_200_000  # of the episodes in the kinematic simulator that score a trial
_TIE_BREAK = 0.004  # below the half percent up to which rates count as equal


@dataclass(frozen=True)
class TrainingResult:
    """The result of one training of a trial."""

    good_rate: float
    mean_return: float
    used_steps: float  # share of its control steps before it stopped early


def run_trial(
    worlds: Mapping[str, Any],
    options: StudyOptions,
    default: Mapping[str, Any],
    name: str,
    known: Sequence[FrozenTrial],
    trial: FrozenTrial,
    path: Path,
) -> FrozenTrial:
    """Run the trainings of a trial in a study of its own, whose pruner knows other trials.

    Args:
        worlds: See `carry`.
        options: Of the study.
        default: The default preset.
        name: Of the study; Hyperband derives a trial's bracket from this and the trial's number.
        known: Finished trials.
        trial: Parameters, distributions and number.
        path: The folder to make, with the trial's folder in it.

    Returns:
        The finished trial, with its reports and user attributes.
    """
    carry(worlds)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    folder = StudyFolder.create(path, options, default)
    study = _study_of_trial(folder, name, known, trial)
    running = study.ask(trial.distributions)
    assert running.number == trial.number
    folder.trial_folder(trial.number).mkdir(parents=True)
    try:
        results = _train(folder, running)
    except TrialPruned as reason:
        running.set_user_attr("reason", str(reason))
        study.tell(running, state=TrialState.PRUNED)
    else:
        running.set_user_attr("good_rates", [result.good_rate for result in results])
        running.set_user_attr("mean_returns", [result.mean_return for result in results])
        running.set_user_attr("used_steps", [result.used_steps for result in results])
        study.tell(running, score(results, folder.default.train.best_by))
    return study.trials[trial.number]


def _study_of_trial(folder: StudyFolder, name: str, known: Sequence[FrozenTrial], trial: FrozenTrial) -> Study:
    """A study in memory whose next trial has the number and the parameters of a given one."""
    study = optuna.create_study(study_name=name, direction="maximize", pruner=make_pruner(folder))
    finished = {each.number: each for each in known}
    unknown = create_trial(state=TrialState.FAIL)
    study.add_trials(finished.get(number, unknown) for number in range(trial.number))
    study.enqueue_trial(trial.params)
    return study


def _train(folder: StudyFolder, trial: Trial) -> list[TrainingResult]:
    """Train with each seed.

    Raises:
        TrialPruned: If the pruner ends the first training, or the settings cannot be trained with.
    """
    path, settings = folder.trial_folder(trial.number), folder.settings(trial.params)
    results: list[TrainingResult] = []
    with (path / "log.txt").open("w", encoding="utf-8") as log, redirect_stdout(log), redirect_stderr(log):
        try:
            for seed in folder.seeds:
                config = folder.config({**settings, "train.save_freq": 0}, seed)
                reporter = None if results else PruningReporter(trial, count_evaluations(folder), config.train.best_by)
                results.append(_train_once(config, folder.run_folder(trial.number, seed), reporter))
        except UnwritableError:
            raise
        except InputError as error:  # other settings may fit
            raise TrialPruned(str(error)) from None
    return results


def _train_once(config: Config, folder: Path, reporter: PruningReporter | None) -> TrainingResult:
    """Train, and evaluate the best policy in episodes that did not select it."""
    training = train_config(config, folder, on_evaluation=reporter)
    if training.interrupted:
        raise KeyboardInterrupt
    if reporter:
        reporter.fill()
    shutil.rmtree(folder / "checkpoints")  # the largest part, and nobody resumes a trial
    with make_evaluator(config.scene.worlds_for("search"), config.train, SCORE_SEED) as evaluator:
        evaluation = evaluator.run(load(folder).policy)
    used_steps = min(1.0, training.timesteps / config.train.total_timesteps)
    return TrainingResult(evaluation.good_rate, evaluation.score[1], used_steps)


class PruningReporter:
    """Reports the evaluations of a training to Optuna's pruner; the step is their number from 1.

    The last value of a training that stops early stands for the remaining evaluations, too, so that other trials are
    compared with it until their end.

    Args:
        trial: The trial.
        count: Evaluations of a whole training.
        best_by: See `TrainSettings`.
    """

    def __init__(self, trial: Trial, count: int, best_by: str) -> None:
        self._trial, self._count, self._by_return = trial, count, best_by == "return"
        self._number, self._last = 0, 0.0

    def __call__(self, evaluation: Evaluation) -> None:
        """Report an evaluation; raises `TrialPruned` if the training is to end."""
        self._number += 1
        self._last = evaluation.score[1] if self._by_return else evaluation.good_rate
        self._trial.report(self._last, self._number)
        if self._number < self._count and self._trial.should_prune():
            raise TrialPruned(f"pruned after {100 * self._number / self._count:.0f} % of the steps")

    def fill(self) -> None:
        """Report the last value for the remaining evaluations."""
        for number in range(self._number + 1, self._count + 1):
            self._trial.report(self._last, number)


def score(results: Sequence[TrainingResult], best_by: str) -> float:
    """The objective of the study: mean share of good episodes, and at equal shares fewer control steps.

    Shares in the same half percent count as equal. With `train.best_by=return` it is the mean return.

    Args:
        results: Of the trainings of a trial, at least one.
        best_by: See `TrainSettings`.
    """
    if best_by == "return":
        return sum(result.mean_return for result in results) / len(results)
    rate = sum(result.good_rate for result in results) / len(results)
    used_steps = sum(result.used_steps for result in results) / len(results)
    return round(200 * rate) / 200 - _TIE_BREAK * used_steps
