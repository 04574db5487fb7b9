"""Runs the trainings of a trial in a worker, which may be on another machine.

A worker uses neither the study's database nor the study's folder.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import optuna
from optuna import Study, Trial, TrialPruned
from optuna.trial import FrozenTrial, TrialState, create_trial

from tb2rl.core.errors import InputError, UnwritableError
from tb2rl.envs.worlds import register_worlds
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs import Config, load
from tb2rl.training.training import make_evaluator, train_config
from tb2rl.tuning.storage import make_pruner
from tb2rl.tuning.study import StudyFolder, StudyOptions

SCORE_SEED = 20_200_000  # seed of the episodes for the score
_STEPS_WEIGHT = 0.004  # what a training of full length loses in the score; less than the rounding of rates, 0.005


@dataclass(frozen=True)
class TrainingResult:
    """The result of one training of a trial."""

    good_rate: float
    mean_return: float
    used_step_share: float  # fraction of `train.total_timesteps` until the training stopped


def run_trial(
    worlds: Mapping[str, Any],
    options: StudyOptions,
    default: Mapping[str, Any],
    name: str,
    finished_trials: Sequence[FrozenTrial],
    trial: FrozenTrial,
    trial_folder: Path,
) -> FrozenTrial:
    """Run the trainings of a trial in a temporary study, whose pruner uses the finished trials of the real study.

    Args:
        worlds: See `register_worlds`.
        options: Options of the study.
        default: Default preset of the study.
        name: Name of the study; Hyperband derives the bracket of a trial from this name and the trial's number.
        finished_trials: Finished trials of the study.
        trial: The trial to run, with its parameters, distributions and number.
        trial_folder: Folder for the files of the trial, which the executor brings to the study.

    Returns:
        The finished trial, with its intermediate values and user attributes.
    """
    register_worlds(worlds)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    trial_folder.mkdir(parents=True)
    with TemporaryDirectory() as parent, (trial_folder / "log.txt").open("w", encoding="utf-8") as log:
        folder = StudyFolder.create(Path(parent), options, default)
        study = _temporary_study(folder, name, finished_trials, trial)
        running_trial = study.ask(trial.distributions)
        assert running_trial.number == trial.number
        try:
            with redirect_stdout(log), redirect_stderr(log):
                results = _train(folder, running_trial, trial_folder)
        except TrialPruned as reason:
            running_trial.set_user_attr("reason", str(reason))
            study.tell(running_trial, state=TrialState.PRUNED)
        else:
            running_trial.set_user_attr("good_rates", [result.good_rate for result in results])
            running_trial.set_user_attr("mean_returns", [result.mean_return for result in results])
            running_trial.set_user_attr("used_step_shares", [result.used_step_share for result in results])
            study.tell(running_trial, score(results, folder.default.train.best_by))
    return study.trials[trial.number]


def _temporary_study(folder: StudyFolder, name: str, finished: Sequence[FrozenTrial], trial: FrozenTrial) -> Study:
    """Make a study in memory whose next trial has the number and the parameters of `trial`; failed trials fill gaps."""
    study = optuna.create_study(study_name=name, direction="maximize", pruner=make_pruner(folder))
    by_number = {other.number: other for other in finished}
    study.add_trials(by_number.get(i) or create_trial(state=TrialState.FAIL) for i in range(trial.number))
    study.enqueue_trial(trial.params)
    return study


def _train(folder: StudyFolder, trial: Trial, trial_folder: Path) -> list[TrainingResult]:
    """Train with each seed, in a run folder in `trial_folder`.

    Raises:
        TrialPruned: If the pruner stops the first training, or a training fails because of its settings.
    """
    settings = {**folder.settings(trial.params), "train.save_freq": 0}
    results: list[TrainingResult] = []
    try:
        for seed in folder.seeds:
            config = folder.config(settings, seed)
            reporter = None if results else PruningReporter(trial, folder.num_evaluations, config.train.best_by)
            results.append(_train_once(config, trial_folder / f"seed-{seed}", reporter))
    except UnwritableError:
        raise
    except InputError as error:  # the study continues, because other settings may work
        raise TrialPruned(str(error)) from None
    return results


def _train_once(config: Config, folder: Path, reporter: PruningReporter | None) -> TrainingResult:
    """Train, and evaluate the best policy in other episodes than those that selected it."""
    training = train_config(config, folder, on_evaluation=reporter)
    if training.signal_number:
        raise KeyboardInterrupt
    if reporter:
        reporter.report_remaining_evaluations()
    shutil.rmtree(folder / "checkpoints")  # to save space, because trials are not resumed
    with make_evaluator(config.scene.for_purpose("search"), config.train, SCORE_SEED) as evaluator:
        evaluation = evaluator.run(load(folder).policy)
    used_step_share = min(1.0, training.timesteps / config.train.total_timesteps)
    return TrainingResult(evaluation.good_rate, evaluation.score[1], used_step_share)


class PruningReporter:
    """Reports evaluations to Optuna's pruner; the number of an evaluation, starting with 1, is Optuna's step.

    Args:
        trial: Trial of the training.
        num_evaluations: Number of evaluations of a complete training.
        best_by: See `TrainSettings`.
    """

    def __init__(self, trial: Trial, num_evaluations: int, best_by: str) -> None:
        self._trial, self._num_evaluations, self._by_return = trial, num_evaluations, best_by == "return"
        self._step, self._last_value = 0, 0.0

    def __call__(self, evaluation: Evaluation) -> None:
        """Report an evaluation; raises `TrialPruned` if the pruner stops the training."""
        self._step += 1
        self._last_value = evaluation.score[1] if self._by_return else evaluation.good_rate
        self._trial.report(self._last_value, self._step)
        if self._step < self._num_evaluations and self._trial.should_prune():
            raise TrialPruned(f"pruned after {100 * self._step / self._num_evaluations:.0f} % of the steps")

    def report_remaining_evaluations(self) -> None:
        """After an early stop, report the last value for each missing evaluation, for comparisons with other trials."""
        for step in range(self._step + 1, self._num_evaluations + 1):
            self._trial.report(self._last_value, step)


def score(results: Sequence[TrainingResult], best_by: str) -> float:
    """The objective of the study: the mean rate of good episodes; among equal rates, fewer control steps are better.

    Rates are equal if they round to the same half percent. With `train.best_by=return`, the mean return is the score.

    Args:
        results: Results of the trainings of a trial, at least one.
        best_by: See `TrainSettings`.
    """
    if best_by == "return":
        return sum(result.mean_return for result in results) / len(results)
    rate = sum(result.good_rate for result in results) / len(results)
    used_step_share = sum(result.used_step_share for result in results) / len(results)
    return round(200 * rate) / 200 - _STEPS_WEIGHT * used_step_share
