"""The command `tune`: creates or continues a study, evaluates its best trials, and writes the results."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from optuna import Study
from optuna.storages import fail_stale_trials
from optuna.trial import FrozenTrial

from tb2rl.core.errors import InputError
from tb2rl.core.values import build
from tb2rl.execution.arguments import make_executor
from tb2rl.runs.algorithm import check_trainable
from tb2rl.runs.layers import as_preset, parse_settings, resolve
from tb2rl.training.trackers import check_trackers
from tb2rl.tuning.page import write_page, write_preset
from tb2rl.tuning.selection import SELECTED, Comparison, TrialEvaluation, compare, evaluate_trial, select_best
from tb2rl.tuning.space import check_space, find_space, parse_space, without_fixed
from tb2rl.tuning.storage import open_study, storage_url
from tb2rl.tuning.study import StudyFolder, StudyOptions
from tb2rl.tuning.trials import best_trials, count_trials, run_trials

_NAME = re.compile(r"[\w-][\w.-]*")
_MAX_COUNT = 100_000


def run(options: argparse.Namespace) -> None:
    """Run trials, evaluate the best ones, write a preset and a page."""
    _check(options)
    executor = make_executor(options)
    folder = requested(options)
    try:
        with executor, open_study(folder) as study:
            _print_start(folder, study, options)
            seconds = None if options.minutes is None else 60 * options.minutes
            if not run_trials(folder, study, options.trials, executor, seconds):
                print(f"the {options.minutes:g} minutes are over", flush=True)
            with folder.selection_lock():
                fail_stale_trials(study)
                _finish(folder, study, options)
    except KeyboardInterrupt:
        print(f"\nstopped; the same command continues {folder.path}, without the trials that ran", flush=True)
        raise


def _check(options: argparse.Namespace) -> None:
    """Raise an `InputError` if an option does not fit."""
    for name, low in {"trials": 1, "seeds": 1, "fresh": 0}.items():
        value = getattr(options, name)
        if not low <= value <= _MAX_COUNT:
            raise InputError(f"--{name} must be from {low} to {_MAX_COUNT}, got {value}")
    if options.minutes is not None and not 0 < options.minutes < 1e6:
        raise InputError(f"--minutes must be greater than 0, got {options.minutes}")
    if options.name is not None and not _NAME.fullmatch(options.name):
        raise InputError(f"--name is the name of a folder, of letters, digits, '-', '_' and '.', got {options.name!r}")


def requested(options: argparse.Namespace) -> StudyFolder:
    """The study of a command line; everything is checked before its folder is created."""
    steps = {} if options.steps is None else {"train.total_timesteps": options.steps}
    base = {"train.simulation": options.simulation, **parse_settings(options.set), **steps}
    arguments = (options.agent, options.task, options.preset)

    def resolve_with(settings: Mapping[str, Any]) -> Any:
        return resolve(*arguments, {**base, **settings})

    config = resolve_with({})
    check_trainable(config)
    check_trackers(config.train.track, options.on is not None)
    if options.space is None and ":" in config.agent_name:
        raise InputError(f"there is no search space for {config.agent_name}: name a file with --space")
    tree, source = find_space(options.space or config.agent_name)
    space = without_fixed(tree, base) if isinstance(tree, Mapping) else tree
    check_space(parse_space(space, source), source, resolve_with)
    others = {name: getattr(options, name) for name in ("seeds", "sampler", "pruner", "seed", "storage")}
    name = options.name or "-".join(part.rpartition(":")[2] for part in (config.task_name, config.agent_name))
    study_options = build(StudyOptions, {"space": space, **others}, "tune")
    return StudyFolder.create(Path("runs", "tune", name), study_options, as_preset(*arguments, base))


def _print_start(folder: StudyFolder, study: Study, options: argparse.Namespace) -> None:
    config, counts = folder.default, count_trials(study)
    finished = counts["complete"] + counts["pruned"]
    done = f", of which {finished} are done" if finished else ""
    url = re.sub(r"(?<=:)[^:/@]+(?=@)", "***", storage_url(folder))  # without its password
    print(
        f"searching {len(folder.space)} settings of {config.agent_name} at {config.task_name} in {config.scene.place}: "
        f"{options.trials} trials{done}, each of {folder.options.seeds} trainings of {config.train.total_timesteps} "
        f"steps\nstudy: {folder.path} (watch it: optuna-dashboard {url})",
        flush=True,
    )


def _finish(folder: StudyFolder, study: Study, options: argparse.Namespace) -> None:
    """Evaluate the best trials, and write the results."""
    counts = count_trials(study)
    print("trials: " + ", ".join(f"{count} {state}" for state, count in counts.items()), flush=True)
    candidates = best_trials(study, SELECTED)
    if not candidates:
        raise InputError(f"no trial of {folder.path} is complete: ask for more --trials or --minutes")
    evaluations = [_evaluate(folder, trial) for trial in candidates]
    selected = select_best(evaluations, folder.default.train.best_by)
    best = next(trial for trial in candidates if trial.number == selected.trial)
    file = write_preset(folder, best, selected, counts["complete"] + counts["pruned"])
    print(f"best: trial {best.number}: python -m tb2rl.train --preset {file}", flush=True)
    page = write_page(folder, study, evaluations, best)
    if options.fresh:
        page = write_page(folder, study, evaluations, best, _compare(folder, best, options.fresh))
    print(page)


def _evaluate(folder: StudyFolder, trial: FrozenTrial) -> TrialEvaluation:
    evaluation = evaluate_trial(folder, trial)
    low, high = evaluation.interval
    rate = f"{100 * evaluation.good_rate:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
    print(
        f"trial {trial.number} in {evaluation.simulator}: {rate} of {evaluation.episodes} episodes are good", flush=True
    )
    return evaluation


def _compare(folder: StudyFolder, best: FrozenTrial, seeds: int) -> Sequence[Comparison]:
    """Train with the best and the default settings and fresh seeds."""
    print(f"training both with {seeds} fresh seeds, standard evaluation of each", flush=True)
    comparisons = []
    for name, settings in {f"trial {best.number}": folder.settings(best.params), "default": {}}.items():
        comparison = compare(folder, name, settings, seeds)
        rates = ", ".join(f"{100 * rate:.1f}" for rate in comparison.rates)
        print(f"{name}: {rates} % of the episodes are good, mean {100 * comparison.mean:.1f} %", flush=True)
        comparisons.append(comparison)
    return comparisons
