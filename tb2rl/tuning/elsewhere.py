"""Trials as jobs: the study stays here, which is asked for trials and told of them; only the trainings are elsewhere.

A node of a cluster sees neither the database nor the folder of the study. A trial goes out with the trials that were
finished when it began, by which the pruner judges it there; its run folders and its values come back.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna import Study, Trial, TrialPruned
from optuna.distributions import BaseDistribution
from optuna.trial import FrozenTrial, TrialState

from tb2rl.core.files import read_yaml
from tb2rl.envs.worlds import carry, worlds_of_files
from tb2rl.execution.executor import Executor
from tb2rl.execution.job import Job
from tb2rl.tuning.storage import pruner
from tb2rl.tuning.study import DEFAULT, Plan, Search
from tb2rl.tuning.trials import FINISHED, Claim, Outcome, next_trial, said_of, same_settings, tell, train_trial

_KNOWN = 300  # trials that the pruner goes by, the latest: half a kilobyte each, with every trial that goes out
_AGAIN = 0.5  # [s] between looks at whether others have ended


@dataclass(frozen=True)
class _Trained:
    """What came of a trial elsewhere."""

    values: Mapping[int, float]  # that were reported, by the number of the evaluation
    outcomes: Sequence[Outcome]  # of its trainings
    pruned: str | None  # why it ended early


def run_elsewhere(search: Search, study: Study, wanted: int, executor: Executor, seconds: float | None = None) -> bool:
    """Let workers run trials until the study has so many.

    Args:
        search: The study's folder.
        study: The study.
        wanted: Trials that it is to have in the end.
        executor: Runs them.
        seconds: Time for it; None: as much as it takes.

    Returns:
        Whether it was over in time; what then still ran is lost.

    Raises:
        InputError: If the disk or the database cannot be written, or there are no workers. What ended before stays.
    """
    deadline = None if seconds is None else time.monotonic() + seconds
    claims: dict[str, Claim] = {}
    shared = (worlds_of_files(search.default.task.world), search.plan, read_yaml(search.folder / DEFAULT))
    try:
        while _finished(study) < wanted:
            left = None if deadline is None else deadline - time.monotonic()
            for job, trained in executor.as_completed(_run, _jobs(search, study, wanted, claims), shared, left):
                claim = claims.pop(job.name)
                print(_note(search, study, claim.trial, trained, job.folder), flush=True)
                claim.lock.release()
            time.sleep(_AGAIN)  # what is missing, others run
    except TimeoutError:
        return False
    finally:
        for claim in claims.values():
            claim.lock.release()
    return True


def _finished(study: Study) -> int:
    return len(study.get_trials(deepcopy=False, states=FINISHED))


def _jobs(search: Search, study: Study, wanted: int, claims: dict[str, Claim]) -> Iterator[Job]:
    """A job for each trial that is begun; what runs, `claims` has by the job's name."""
    while (claim := next_trial(search, study, wanted, wait=False)) is not None:
        trial = claim.trial
        if same_settings(study, trial) is not None:
            study.tell(trial, state=TrialState.PRUNED)
            claim.lock.release()
            continue
        known = study.get_trials(deepcopy=False, states=FINISHED)[-_KNOWN:]
        name, folder = f"trial {trial.number}", search.folder / "trials" / f".{trial.number:04d}"
        claims[name] = claim
        yield Job(name, (known, trial.params, trial.distributions), folder)


def _run(
    worlds: Mapping[str, Any],
    plan: Plan,
    default: Mapping[str, Any],
    known: Sequence[FrozenTrial],
    parameters: Mapping[str, Any],
    distributions: Mapping[str, BaseDistribution],
    folder: Path,
) -> _Trained:
    """A job: the trainings of a trial, in a study of its own that knows what the other one knew."""
    carry(worlds)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    search = Search.begin(folder, plan, default)
    study = optuna.create_study(direction="maximize", pruner=pruner(search))
    study.add_trials(known)
    study.enqueue_trial(dict(parameters))
    trial = study.ask(dict(distributions))
    search.trial_folder(trial.number).mkdir(parents=True)
    outcomes, pruned = [], None
    try:
        outcomes = train_trial(search, trial)
    except TrialPruned as reason:
        pruned = str(reason)
        search.forget(trial.number)
    return _Trained(study.trials[trial.number].intermediate_values, outcomes, pruned)


def _note(search: Search, study: Study, trial: Trial, trained: _Trained, folder: Path | None) -> str:
    """Put what came back into the study and its folder, and say in a line what it is."""
    assert folder is not None
    for number, value in trained.values.items():
        trial.report(value, number)
    for run in folder.glob("trials/*/*"):
        if not run.name.startswith("."):
            run.rename(search.trial_folder(trial.number) / run.name)
    shutil.rmtree(folder)
    if trained.pruned is not None:
        study.tell(trial, state=TrialState.PRUNED)
        search.forget(trial.number)
        return f"trial {trial.number}: {trained.pruned}"
    tell(search, study, trial, trained.outcomes)
    return f"trial {trial.number}: {said_of(study, trial, trained.outcomes)}"
