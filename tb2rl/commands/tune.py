"""Implementation of `python -m tb2rl.tune`: creates or continues a study, and evaluates the best trials."""

import argparse
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError, install_extra

try:
    from optuna import Study
    from optuna.storages import fail_stale_trials
    from optuna.trial import FrozenTrial
except ImportError:
    raise InputError(f"tune needs Optuna: {install_extra('tune')}") from None

from tb2rl.core.values import build
from tb2rl.evaluation.progress import say
from tb2rl.execution.arguments import make_executor
from tb2rl.runs import as_preset, parse_settings, resolve
from tb2rl.runs.algorithm import check_trainable
from tb2rl.training.trackers import check_trackers
from tb2rl.tuning.page import write_page, write_preset
from tb2rl.tuning.selection import NUM_SELECTED, Comparison, TrialEvaluation, compare, evaluate_trial, select_best
from tb2rl.tuning.storage import open_study, storage_url
from tb2rl.tuning.study import StudyFolder, StudyOptions, read_space
from tb2rl.tuning.trials import best_trials, count_trials, run_trials


def run(options: argparse.Namespace) -> None:
    """Run trials, evaluate the best ones, write a preset and a page."""
    if options.name is not None and not re.fullmatch(r"[\w-][\w.-]*", options.name):
        raise InputError(f"--name is {options.name!r}; give a folder name of letters, digits, '-', '_' and '.'")
    executor = make_executor(options)
    folder = create_study(options)
    try:
        with executor, open_study(folder) as study:
            _print_start(folder, study, options)
            seconds = None if options.minutes is None else 60 * options.minutes
            if not run_trials(folder, study, options.trials, executor, seconds):
                say(f"time limit of {options.minutes:g} minutes reached")
            with folder.selection_lock():
                fail_stale_trials(study)
                _finish(folder, study, options)
    except KeyboardInterrupt:
        say(f"\nstopped; the same command continues {folder.path}, without the trials that were running")
        raise


def create_study(options: argparse.Namespace) -> StudyFolder:
    """Create or open the study of a command line, after all arguments are checked."""
    steps = {} if options.steps is None else {"train.total_timesteps": options.steps}
    base = {"train.simulation": options.simulation, **parse_settings(options.set), **steps}
    arguments = (options.agent, options.task, options.preset)

    def resolve_with(settings: Mapping[str, Any]) -> Any:
        return resolve(*arguments, {**base, **settings})

    config = resolve_with({})
    check_trainable(config)
    check_trackers(config.train.track, on_cluster=options.on is not None)
    if options.space is None and ":" in config.agent_name:
        raise InputError(f"there is no default search space for {config.agent_name}; give a file with --space")
    space = read_space(options.space or config.agent_name, base, resolve_with)
    study_settings = {name: getattr(options, name) for name in ("seeds", "sampler", "pruner", "seed", "storage")}
    name = options.name or "-".join(part.rpartition(":")[2] for part in (config.task_name, config.agent_name))
    study_options = build(StudyOptions, {"space": space, **study_settings}, "tune")
    return StudyFolder.create(Path("runs", "tune", name), study_options, as_preset(*arguments, base))


def _print_start(folder: StudyFolder, study: Study, options: argparse.Namespace) -> None:
    config, counts = folder.default, count_trials(study)
    finished = counts["complete"] + counts["pruned"]
    progress = f", of which {finished} are done" if finished else ""
    url = re.sub(r"(?<=:)[^:/@]+(?=@)", "***", storage_url(folder))  # hides the password
    trainings = f"{folder.options.seeds} trainings of {config.train.total_timesteps} steps"
    task = f"{config.agent_name} at {config.task_name} in {config.scene.worlds_title}"
    say(f"searching {len(folder.space)} settings of {task}: {options.trials} trials{progress}, each of {trainings}")
    say(f"study: {folder.path} (watch it: optuna-dashboard {url})")


def _finish(folder: StudyFolder, study: Study, options: argparse.Namespace) -> None:
    """Evaluate the best trials, and write the results."""
    counts = count_trials(study)
    say("trials: " + ", ".join(f"{count} {state}" for state, count in counts.items()))
    candidates = best_trials(study, NUM_SELECTED)
    if not candidates:
        raise InputError(f"no trial of {folder.path} is complete; raise --trials or --minutes")
    evaluations = list[TrialEvaluation]()
    for trial in candidates:
        evaluations.append(evaluation := evaluate_trial(folder, trial))
        low, high = evaluation.interval
        rate = f"{100 * evaluation.good_rate:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
        say(f"trial {trial.number} in {evaluation.simulator}: {rate} of {evaluation.episodes} episodes are good")
    selected = select_best(evaluations, folder.default.train.best_by)
    best = candidates[evaluations.index(selected)]
    file = write_preset(folder, best, selected, counts["complete"] + counts["pruned"])
    say(f"best: trial {best.number}: python -m tb2rl.train --preset {file}")
    page = write_page(folder, study, evaluations, best)
    if options.fresh:
        write_page(folder, study, evaluations, best, [*_compare(folder, best, options.fresh)])  # now with comparisons
    print(page)


def _compare(folder: StudyFolder, best: FrozenTrial, seeds: int) -> Iterator[Comparison]:
    """Compare the best settings with the default settings, by trainings with new seeds."""
    say(f"training with the best and the default settings and {seeds} new seeds, standard evaluation of each")
    for name, settings in {f"trial {best.number}": folder.settings(best.params), "default": {}}.items():
        comparison = compare(folder, name, settings, seeds)
        rates = ", ".join(f"{100 * rate:.1f}" for rate in comparison.rates)
        say(f"{name}: {rates} % of the episodes are good, mean {100 * comparison.mean:.1f} %")
        yield comparison
