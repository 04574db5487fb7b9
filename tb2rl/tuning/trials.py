"""Runs the trials of a study: asks Optuna for settings, trains on workers, and tells Optuna the results."""

import math
import time
from collections.abc import Callable, Iterator, Mapping

from optuna import Study, Trial
from optuna.exceptions import UpdateFinishedTrialError
from optuna.storages import fail_stale_trials
from optuna.trial import FrozenTrial, TrialState

from tb2rl.core.files import read_yaml
from tb2rl.envs.worlds import worlds_of_files
from tb2rl.execution.executor import Executor, Job
from tb2rl.tuning.storage import heartbeats, make_sampler
from tb2rl.tuning.study import DEFAULT, StudyFolder
from tb2rl.tuning.training import run_trial

_MAX_HISTORY = 300  # latest finished trials that a job gets for its pruner; limited, because each has half a kilobyte
_POLL_PERIOD = 0.5  # [s] period of checking the trials of other processes
_HAS_HEARTBEAT = "has_heartbeat"  # user attribute; to Optuna, a trial that never had a heartbeat is never stale
_COUNTED = (TrialState.COMPLETE, TrialState.PRUNED)  # states that count towards `n_trials`


def run_trials(
    folder: StudyFolder, study: Study, n_trials: int, executor: Executor, timeout: float | None = None
) -> bool:
    """Run trials until the study has `n_trials`; other processes may run trials of the same study.

    Args:
        folder: Folder of the study.
        study: The study.
        n_trials: Number of complete and pruned trials at which to stop, including existing trials.
        executor: Executor for the trials.
        timeout: Time limit [s]; None: no limit.

    Returns:
        Whether the study has `n_trials`; False after a timeout, which fails the running trials.

    Raises:
        InputError: If the disk or the database cannot be written, or there are no workers. Finished trials are kept.
    """
    deadline = math.inf if timeout is None else time.monotonic() + timeout
    shared = (worlds_of_files(folder.default.task.world), folder.options, read_yaml(folder.path / DEFAULT))
    running: dict[str, Trial] = {}  # trials by the name of their job
    with heartbeats(folder, running) as record_heartbeat:
        try:
            while True:
                jobs = _ask_jobs(folder, study, n_trials, record_heartbeat, running)
                for job, result in executor.as_completed(run_trial, jobs, shared, deadline - time.monotonic()):
                    print(_tell(folder, study, running[job.name], result), flush=True)
                    del running[job.name]
                is_complete = len(study.get_trials(deepcopy=False, states=_COUNTED)) >= n_trials
                if is_complete or time.monotonic() > deadline:
                    return is_complete
                time.sleep(_POLL_PERIOD)  # other processes run the last trials
        except TimeoutError:
            return False
        finally:
            for trial in running.values():
                study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
                folder.remove_files(trial.number)


def _ask_jobs(
    folder: StudyFolder,
    study: Study,
    n_trials: int,
    record_heartbeat: Callable[[Trial], None],
    running: dict[str, Trial],
) -> Iterator[Job]:
    """Ask for new trials; prune repetitions of earlier ones, add the others to `running`, and yield a job for each."""
    while (trial := ask(folder, study, n_trials, record_heartbeat)) is not None:
        name = f"trial {trial.number}"
        running[name] = trial
        trials = study.get_trials(deepcopy=False)
        earlier_trials = [other for other in trials[: trial.number] if other.state in (*_COUNTED, TrialState.RUNNING)]
        earlier_number = next((other.number for other in earlier_trials if other.params == trial.params), None)
        if earlier_number is None:
            finished = [other for other in trials if other.state in _COUNTED][-_MAX_HISTORY:]
            yield Job(name, (study.study_name, finished, trials[trial.number]), folder.trial_folder(trial.number))
        else:
            study.tell(trial, state=TrialState.PRUNED)
            del running[name]
            print(f"{name}: the same settings as trial {earlier_number}", flush=True)


def ask(folder: StudyFolder, study: Study, n_trials: int, record_heartbeat: Callable[[Trial], None]) -> Trial | None:
    """Ask the study for a new trial; returns None if it has `n_trials` complete, pruned and running trials."""
    with folder.lock():
        fail_stale_trials(study)
        for running_trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            # We have the lock, so the process of a trial without a heartbeat died in here; Optuna would never fail it.
            if _HAS_HEARTBEAT not in running_trial.user_attrs:
                study.tell(running_trial.number, state=TrialState.FAIL)
        trials = study.get_trials(deepcopy=False)
        if sum(trial.state in (*_COUNTED, TrialState.RUNNING) for trial in trials) >= n_trials:
            return None
        study.sampler = make_sampler(folder.options, trial_number=len(trials))
        trial = study.ask({key: entry.distribution for key, entry in folder.space.items()})
        record_heartbeat(trial)
        trial.set_user_attr(_HAS_HEARTBEAT, True)
        return trial


def _tell(folder: StudyFolder, study: Study, trial: Trial, result: FrozenTrial) -> str:
    """Tell the study the result of a trial; return a line that describes the result."""
    name = f"trial {trial.number}"
    try:
        for step, value in result.intermediate_values.items():
            trial.report(value, step)
            trial.should_prune()  # for its side effect: Hyperband records the rungs that the trial reached
        for key, attribute in result.user_attrs.items():
            trial.set_user_attr(key, attribute)
        is_pruned = result.state is TrialState.PRUNED
        if is_pruned:
            folder.remove_files(trial.number)
        study.tell(trial, None if is_pruned else result.value, result.state)
    except UpdateFinishedTrialError:
        folder.remove_files(trial.number)
        return f"{name}: failed, because its heartbeats were late; another trial replaces it"
    assert result.duration is not None
    seconds = f"({result.duration.total_seconds():.0f} s)"
    if is_pruned:
        return f"{name}: {result.user_attrs['reason']} {seconds}"
    best = ", the best so far" if study.best_trial.number == trial.number else ""
    rates = ", ".join(f"{100 * rate:.1f}" for rate in result.user_attrs["good_rates"])
    shares = result.user_attrs["used_step_shares"]
    steps = f"{100 * sum(shares) / len(shares):.0f} % of the steps"
    return f"{name}: {rates} % good episodes after {steps}{best} {seconds}"


def best_trials(study: Study, limit: int | None = None) -> list[FrozenTrial]:
    """The complete trials, highest score first; the earlier trial wins a tie. `limit` is their maximum number."""
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return sorted(complete, key=lambda trial: (-(trial.value or 0.0), trial.number))[:limit]


def count_trials(study: Study) -> Mapping[str, int]:
    """Number of trials by state: complete, pruned, failed."""
    states = [trial.state.name.lower() for trial in study.get_trials(deepcopy=False)]
    return {"complete": states.count("complete"), "pruned": states.count("pruned"), "failed": states.count("fail")}
