"""Trials of a study: this process asks Optuna for settings, workers train with them, and it tells Optuna the result."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress

from optuna import Study, Trial
from optuna.exceptions import UpdateFinishedTrialError
from optuna.storages import fail_stale_trials
from optuna.trial import FrozenTrial, TrialState

from tb2rl.core.files import read_yaml
from tb2rl.envs.worlds import worlds_of_files
from tb2rl.execution.executor import Executor
from tb2rl.execution.job import Job
from tb2rl.tuning.storage import Heartbeats, make_sampler
from tb2rl.tuning.study import DEFAULT, StudyFolder
from tb2rl.tuning.training import run_trial

_KNOWN = 300  # finished trials that the pruner of a trial knows, the latest: half a kilobyte each
_POLL = 0.5  # [s] between looks at the trials of other processes
_FINISHED = (TrialState.COMPLETE, TrialState.PRUNED)


def run_trials(
    folder: StudyFolder, study: Study, wanted: int, executor: Executor, seconds: float | None = None
) -> bool:
    """Run trials until the study has so many, beside other processes that do the same.

    Args:
        folder: Of the study.
        study: The study.
        wanted: Complete and pruned trials of the study in the end.
        executor: Runs the trials.
        seconds: Time limit; None: no limit.

    Returns:
        Whether the study has so many trials; False if the time was over, and then the running trials failed.

    Raises:
        InputError: If the disk or the database cannot be written, or there are no workers. Finished trials stay.
    """
    deadline = None if seconds is None else time.monotonic() + seconds
    shared = (worlds_of_files(folder.default.task.world), folder.options, read_yaml(folder.path / DEFAULT))
    running: dict[str, Trial] = {}
    with Heartbeats(folder) as heartbeats:
        try:
            while sum(count_trials(study)[name] for name in ("complete", "pruned")) < wanted:
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    return False
                jobs = _ask_jobs(folder, study, wanted, heartbeats, running)
                for job, result in executor.as_completed(run_trial, jobs, shared, left):
                    print(_tell(folder, study, running[job.name], result), flush=True)
                    heartbeats.remove(running.pop(job.name).number)
                time.sleep(_POLL)  # other processes run the remaining trials
        except TimeoutError:
            return False
        finally:
            for trial in running.values():
                study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
                folder.remove_trial(trial.number)
    return True


def _ask_jobs(
    folder: StudyFolder, study: Study, wanted: int, heartbeats: Heartbeats, running: dict[str, Trial]
) -> Iterator[Job]:
    """A job for each trial; `running` has the trial by the job's name."""
    while (trial := ask(folder, study, wanted, heartbeats)) is not None:
        name = f"trial {trial.number}"
        running[name] = trial
        same = _find_same_params(study, trial)
        if same is not None:
            study.tell(trial, state=TrialState.PRUNED)
            heartbeats.remove(running.pop(name).number)
            print(f"{name}: the same settings as trial {same}", flush=True)
            continue
        trials = study.get_trials(deepcopy=False)
        known = [each for each in trials if each.state in _FINISHED][-_KNOWN:]
        yield Job(name, (study.study_name, known, trials[trial.number]), folder.staging_folder(trial.number))


def ask(folder: StudyFolder, study: Study, wanted: int, heartbeats: Heartbeats) -> Trial | None:
    """Ask for a trial; None if the finished and running ones are as many as wanted."""
    with folder.lock():
        fail_stale_trials(study)
        trials = study.get_trials(deepcopy=False)
        if sum(trial.state in (*_FINISHED, TrialState.RUNNING) for trial in trials) >= wanted:
            return None
        study.sampler = make_sampler(folder.options, len(trials))
        try:
            trial = study.ask({key: entry.distribution for key, entry in folder.space.items()})
            heartbeats.add(trial.number)
            return trial
        except BaseException:  # such as Ctrl-C; a trial without a heartbeat would never count as stale
            with suppress(ValueError):  # it was not created
                study.tell(len(trials), state=TrialState.FAIL)
            raise


def _find_same_params(study: Study, trial: Trial) -> int | None:
    """The number of an earlier trial with the same parameters."""
    others = study.get_trials(deepcopy=False, states=(*_FINISHED, TrialState.RUNNING))
    return next((each.number for each in others if each.number < trial.number and each.params == trial.params), None)


def _tell(folder: StudyFolder, study: Study, trial: Trial, result: FrozenTrial) -> str:
    """Copy the result of a trial to the study and its files to the folder; a line on it."""
    name = f"trial {trial.number}"
    try:
        for step, value in result.intermediate_values.items():
            trial.report(value, step)
            trial.should_prune()  # notes in the study which rungs of Hyperband the trial reached
        for key, attribute in result.user_attrs.items():
            trial.set_user_attr(key, attribute)
        staging = folder.staging_folder(trial.number)
        if result.state is TrialState.COMPLETE:
            (staging / "trials" / folder.trial_folder(trial.number).name).rename(folder.trial_folder(trial.number))
        shutil.rmtree(staging)
        study.tell(trial, result.value if result.state is TrialState.COMPLETE else None, result.state)
    except UpdateFinishedTrialError:
        folder.remove_trial(trial.number)
        return f"{name}: failed, because its heartbeats were late; another trial takes its place"
    assert result.duration is not None
    return f"{name}: {_describe(study, result)} ({result.duration.total_seconds():.0f} s)"


def _describe(study: Study, trial: FrozenTrial) -> str:
    if trial.state is TrialState.PRUNED:
        return str(trial.user_attrs["reason"])
    best = ", the best so far" if study.best_trial.number == trial.number else ""
    rates = ", ".join(f"{100 * rate:.1f}" for rate in trial.user_attrs["good_rates"])
    used_steps = trial.user_attrs["used_steps"]
    return f"{rates} % good episodes after {100 * sum(used_steps) / len(used_steps):.0f} % of the steps{best}"


def best_trials(study: Study, count: int) -> list[FrozenTrial]:
    """The complete trials of the highest scores, the best first; of equal ones the earlier."""
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return sorted(complete, key=lambda trial: (-(trial.value or 0.0), trial.number))[:count]


def count_trials(study: Study) -> Mapping[str, int]:
    """How many trials are complete, pruned and failed."""
    states = [trial.state.name.lower() for trial in study.get_trials(deepcopy=False)]
    return {"complete": states.count("complete"), "pruned": states.count("pruned"), "failed": states.count("fail")}
