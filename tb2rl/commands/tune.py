"""What `tune` does, see `tb2rl.tune`: begins a study or goes on with it, judges its best trials, says what they are."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from optuna import Study
from optuna.trial import FrozenTrial

from tb2rl.core.errors import InputError
from tb2rl.core.values import build
from tb2rl.execution.arguments import make_executor
from tb2rl.execution.executor import Executor
from tb2rl.runs.algorithm import check_trainable
from tb2rl.runs.layers import as_preset, parse_settings, resolve
from tb2rl.training.trackers import check_trackers
from tb2rl.tuning.elsewhere import run_elsewhere
from tb2rl.tuning.judging import JUDGED, Comparison, Judgement, best_of, compare, judge
from tb2rl.tuning.page import write_page, write_preset
from tb2rl.tuning.space import check_space, find_space, space_from, without_fixed
from tb2rl.tuning.storage import open_study, storage_url
from tb2rl.tuning.study import Plan, Search
from tb2rl.tuning.trials import best_trials, counts, drop_lost
from tb2rl.tuning.workers import run_workers

_NAME = re.compile(r"[\w-][\w.-]*")
_MOST = 100_000  # of trials, and of anything else that is counted


def run(options: argparse.Namespace) -> None:
    """Run trials, judge the best, write a preset and a page."""
    check(options)
    executor = make_executor(options)
    search = requested(options)
    try:
        with executor, open_study(search) as study:
            _say_began(search, study, options)
            seconds = None if options.minutes is None else 60 * options.minutes
            if not _run_trials(search, study, executor, options.trials, seconds):
                print(f"the {options.minutes:g} minutes are over", flush=True)
            with search.lock():
                drop_lost(search, study)
            with search.finishing():
                _finish(search, study, options)
    except KeyboardInterrupt:
        print(f"\nstopped; the same command goes on with {search.folder}, without the trials that ran", flush=True)
        raise


def _run_trials(search: Search, study: Study, executor: Executor, trials: int, seconds: float | None) -> bool:
    """Run trials until the study has so many; whether it was over in time."""
    if executor.remote:
        return run_elsewhere(search, study, trials, executor, seconds)
    return run_workers(search, trials, min(executor.num_workers, trials), seconds)


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` where options do not fit."""
    least = {"trials": 1, "seeds": 1, "fresh": 0}
    for name, low in least.items():
        value = getattr(options, name)
        if value is not None and not low <= value <= _MOST:
            raise InputError(f"--{name} must be from {low} to {_MOST}, got {value}")
    if options.minutes is not None and not 0 < options.minutes < 1e6:
        raise InputError(f"--minutes must be greater than 0, got {options.minutes}")
    if options.name is not None and not _NAME.fullmatch(options.name):
        raise InputError(f"--name is the name of a folder, of letters, digits, '-', '_' and '.', got {options.name!r}")


def requested(options: argparse.Namespace) -> Search:
    """The study that a command line asks for, all checked before its folder is made."""
    fixed = parse_settings(options.set)
    steps = {} if options.steps is None else {"train.total_timesteps": options.steps}
    base = {"train.simulation": options.simulation, **fixed, **steps}
    arguments = (options.agent, options.task, options.preset)

    def resolved(settings: Mapping[str, Any]) -> Any:
        return resolve(*arguments, {**base, **settings})

    config = resolved({})
    check_trainable(config)
    check_trackers(config.train.track, options.on is not None)
    tree, file = find_space(options.space or _space_name(config.agent_name))
    space = without_fixed(tree, base) if isinstance(tree, Mapping) else tree
    check_space(space_from(space, file), file, resolved)
    how = {name: getattr(options, name) for name in ("seeds", "sampler", "pruner", "seed", "storage")}
    plan = build(Plan, {"space": space, **how}, "tune")
    name = options.name or f"{_file_name(config.task_name)}-{_file_name(config.agent_name)}"
    return Search.begin(Path("runs", "tune", name), plan, as_preset(*arguments, base))


def _space_name(agent: str) -> str:
    if ":" in agent:
        raise InputError(f"there is no search space for {agent}: name a file with --space")
    return agent


def _file_name(name: str) -> str:
    return name.rpartition(":")[2]


def _say_began(search: Search, study: Study, options: argparse.Namespace) -> None:
    config, plan, done = search.default, search.plan, counts(study)
    finished = done["complete"] + done["pruned"]
    began = f", of which {finished} are done" if finished else ""
    print(
        f"searching {len(search.space)} settings of {config.agent_name} at {config.task_name} in {config.scene.place}: "
        f"{options.trials} trials{began}, each of {plan.seeds} trainings of {config.train.total_timesteps} steps\n"
        f"study: {search.folder} (watch it: optuna-dashboard {_shown(storage_url(search))})",
        flush=True,
    )


def _shown(url: str) -> str:
    """A URL without its password."""
    return re.sub(r"(?<=:)[^:/@]+(?=@)", "***", url)


def _finish(search: Search, study: Study, options: argparse.Namespace) -> None:
    """Judge the best trials, and write what was found."""
    done = counts(study)
    print(f"trials: {done['complete']} complete, {done['pruned']} pruned, {done['lost']} lost", flush=True)
    candidates = best_trials(study, JUDGED)
    if not candidates:
        raise InputError(f"no trial of {search.folder} came to its end: ask for more --trials or --minutes")
    judgements = [_judged(search, trial) for trial in candidates]
    chosen = best_of(judgements, search.default.train.best_by)
    best = next(trial for trial in candidates if trial.number == chosen.trial)
    file = write_preset(search, best, chosen, done["complete"] + done["pruned"])
    print(f"best: trial {best.number}: python -m tb2rl.train --preset {file}", flush=True)
    page = write_page(search, study, judgements, best)
    if options.fresh:
        page = write_page(search, study, judgements, best, _compared(search, best, options.fresh))
    print(page)


def _judged(search: Search, trial: FrozenTrial) -> Judgement:
    judgement = judge(search, trial)
    where = "PyBullet" if judgement.simulation == "bullet" else "the fast twin"
    low, high = judgement.interval
    rate = f"{100 * judgement.good_rate:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
    print(f"trial {trial.number} in {where}: {rate} of {judgement.episodes} episodes are good", flush=True)
    return judgement


def _compared(search: Search, best: FrozenTrial, seeds: int) -> Sequence[Comparison]:
    """Best and default settings with fresh seeds."""
    both = {f"trial {best.number}": search.settings(best.params), "default": {}}
    print(f"training both with {seeds} fresh seeds, standard evaluation of each", flush=True)
    comparisons = []
    for name, settings in both.items():
        comparison = compare(search, name.replace(" ", "-"), settings, seeds)
        rates = ", ".join(f"{100 * rate:.1f}" for rate in comparison.rates)
        print(f"{name}: {rates} % of the episodes are good, mean {100 * comparison.mean:.1f} %", flush=True)
        comparisons.append(comparison)
    return comparisons
