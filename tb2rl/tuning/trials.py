"""Trials of a study: which one is next, how it is trained with several seeds, and what it scores."""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from optuna import Study, Trial, TrialPruned
from optuna.trial import FrozenTrial, TrialState

from tb2rl.core.errors import InputError, UnwritableError
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs.config import Config
from tb2rl.runs.loading import load
from tb2rl.training.environments import make_evaluator
from tb2rl.training.training import train_config
from tb2rl.tuning.storage import evaluations, sampler
from tb2rl.tuning.study import Search

SCORE_SEED = 20_200_000  # of the episodes in the twin that score a trial
_TIE_BREAK = 0.004  # less than the half percent up to which rates count alike
_AGAIN = 0.5  # [s] between looks at whether the others have ended
FINISHED = (TrialState.COMPLETE, TrialState.PRUNED)


@dataclass(frozen=True)
class Claim:
    """A trial that this process alone runs while it holds the lock."""

    trial: Trial
    lock: FileLock


@dataclass(frozen=True)
class Outcome:
    """What one training of a trial came to."""

    good_rate: float
    mean_return: float
    share: float  # of the control steps that it might have had


def run_trials(search: Search, study: Study, wanted: int) -> None:
    """Run trials until the study has so many, beside other processes that do the same.

    Raises:
        InputError: If the disk or the database cannot be written. What ended before stays.
    """
    while (claim := next_trial(search, study, wanted)) is not None:
        try:
            print(_run(search, study, claim.trial), flush=True)
        finally:
            claim.lock.release()


def next_trial(search: Search, study: Study, wanted: int, wait: bool = True) -> Claim | None:
    """Begin a trial, or wait for those that others run: these may be lost.

    None: the study has as many as wanted, or, if this does not `wait`, those that run are the rest.
    """
    while True:
        with search.lock():
            drop_lost(search, study)
            trials = study.get_trials(deepcopy=False)
            finished = sum(trial.state in FINISHED for trial in trials)
            if finished >= wanted:
                return None
            if finished + sum(trial.state is TrialState.RUNNING for trial in trials) < wanted:
                study.sampler = sampler(search.plan, len(trials))
                trial = study.ask({key: entry.distribution for key, entry in search.space.items()})
                lock = search.trial_lock(trial.number)
                lock.acquire()
                return Claim(trial, lock)
        if not wait:
            return None
        time.sleep(_AGAIN)


def drop_lost(search: Search, study: Study) -> None:
    """Fail the trials that nobody runs any more; the lock of the study is held meanwhile."""
    for number in _running(study):
        try:
            with search.trial_lock(number):
                if number in _running(study):  # it may have ended before its lock was free
                    study.tell(number, state=TrialState.FAIL)
                    search.forget(number)
        except Timeout:  # its process lives
            continue


def _running(study: Study) -> list[int]:
    return [trial.number for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))]


def _run(search: Search, study: Study, trial: Trial) -> str:
    """Run a trial to its end, and say in a line what came out."""
    started, named = time.monotonic(), f"trial {trial.number}"
    same = same_settings(study, trial)
    if same is not None:
        study.tell(trial, state=TrialState.PRUNED)
        return f"{named}: the same settings as trial {same}"
    try:
        outcomes = train_trial(search, trial)
    except TrialPruned as reason:
        study.tell(trial, state=TrialState.PRUNED)
        search.forget(trial.number)  # not before: others would think it lost
        return f"{named}: {reason} ({time.monotonic() - started:.0f} s)"
    tell(search, study, trial, outcomes)
    return f"{named}: {said_of(study, trial, outcomes)} ({time.monotonic() - started:.0f} s)"


def tell(search: Search, study: Study, trial: Trial, outcomes: Sequence[Outcome]) -> None:
    """Tell a study what the trainings of a trial came to."""
    trial.set_user_attr("good_rates", [outcome.good_rate for outcome in outcomes])
    trial.set_user_attr("mean_returns", [outcome.mean_return for outcome in outcomes])
    study.tell(trial, score(outcomes, search.default.train.best_by))


def said_of(study: Study, trial: Trial, outcomes: Sequence[Outcome]) -> str:
    """What the trainings of a trial came to, in words."""
    best = ", the best so far" if study.best_trial.number == trial.number else ""
    rates = ", ".join(f"{100 * outcome.good_rate:.1f}" for outcome in outcomes)
    share = sum(outcome.share for outcome in outcomes) / len(outcomes)
    return f"{rates} % good episodes after {100 * share:.0f} % of the steps{best}"


def same_settings(study: Study, trial: Trial) -> int | None:
    """The number of an earlier trial with the same settings, which would come to the same."""
    others = study.get_trials(deepcopy=False, states=(*FINISHED, TrialState.RUNNING))
    return next(
        (other.number for other in others if other.number < trial.number and other.params == trial.params), None
    )


def train_trial(search: Search, trial: Trial) -> list[Outcome]:
    """Train with each seed; raises `TrialPruned` with the reason where it is not worth its time."""
    folder, settings = search.trial_folder(trial.number), search.settings(trial.params)
    outcomes: list[Outcome] = []
    with (folder / "log.txt").open("w", encoding="utf-8") as log, redirect_stdout(log), redirect_stderr(log):
        try:
            for seed in search.seeds:
                report = None if outcomes else Reports(trial, evaluations(search), search.default.train.best_by)
                config = search.config({**settings, "train.save_freq": 0}, seed)
                outcomes.append(_outcome(config, search.run_folder(trial.number, seed), report))
        except UnwritableError:
            raise
        except InputError as error:  # these settings cannot be trained with; others can
            trial.set_user_attr("reason", str(error))
            raise TrialPruned(str(error)) from None
    return outcomes


def _outcome(config: Config, folder: Path, report: Reports | None) -> Outcome:
    """Train once, and drive the policy that was kept in episodes that had no part in keeping it."""
    training = train_config(config, folder, on_evaluation=report)
    if training.interrupted:
        raise KeyboardInterrupt
    if report:
        report.fill()
    shutil.rmtree(folder / "checkpoints")  # they are the largest part, and nobody resumes a trial
    with make_evaluator(config.scene, config.train, "search", SCORE_SEED) as evaluator:
        evaluation = evaluator.run(load(folder).policy)
    share = min(1.0, training.timesteps / config.train.total_timesteps)
    return Outcome(evaluation.good_rate, evaluation.score[1], share)


class Reports:
    """Tells Optuna's pruner of the evaluations of a training, by their number from 1.

    A training that is good enough stops early: its last value stands for the evaluations that it did not need, so
    that others are held against it to the end.

    Args:
        trial: Whose training it is.
        count: Evaluations of a whole training.
        best_by: What makes a policy the best, see `TrainSettings`.
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
            share = 100 * self._number / self._count
            raise TrialPruned(f"pruned after {share:.0f} % of the steps")

    def fill(self) -> None:
        """Report the last value for all evaluations that did not take place."""
        for number in range(self._number + 1, self._count + 1):
            self._trial.report(self._last, number)


def score(outcomes: Sequence[Outcome], best_by: str) -> float:
    """What a trial is ranked by: the mean share of good episodes, and at equal shares the steps that it needed.

    Shares of the same half percent count as equal. Where a training keeps the policy of the highest return
    (`train.best_by=return`), it is the mean return.

    Args:
        outcomes: Of its trainings, at least one.
        best_by: See `TrainSettings`.
    """
    if best_by == "return":
        return sum(outcome.mean_return for outcome in outcomes) / len(outcomes)
    rate = sum(outcome.good_rate for outcome in outcomes) / len(outcomes)
    share = sum(outcome.share for outcome in outcomes) / len(outcomes)
    return round(200 * rate) / 200 - _TIE_BREAK * share


def best_trials(study: Study, count: int) -> list[FrozenTrial]:
    """The trials of the highest scores, the best first; of equal ones the earlier."""
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return sorted(complete, key=lambda trial: (-_value(trial), trial.number))[:count]


def _value(trial: FrozenTrial) -> float:
    assert trial.value is not None
    return trial.value


def counts(study: Study) -> Mapping[str, int]:
    """How many trials came to their end, were pruned, and were lost."""
    names = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "lost": TrialState.FAIL}
    states: list[Any] = [trial.state for trial in study.get_trials(deepcopy=False)]
    return {name: states.count(state) for name, state in names.items()}
