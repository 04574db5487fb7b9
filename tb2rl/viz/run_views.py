"""The runs on a report's page: found by reference, read from their folders, and grouped by all but their seeds."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import top_folder
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation, kept_evaluation
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run, config_file, read_config
from tb2rl.runs.hub import HUB, cached_reference
from tb2rl.runs.loading import checkpoint_file, config_of, load
from tb2rl.viz.charts import GROUP_COLOURS, distinct_colours
from tb2rl.viz.curves import Curve, read_curves

_EPISODES = 20  # of an evaluation that is made for the page


@dataclass(frozen=True)
class RunView:
    """A run as the page shows it.

    Attributes:
        name: Its name on the page.
        config: Its config.
        versions: Versions of the packages that trained it.
        policy: The best one.
        curves: By the tag in TensorBoard or the key in evaluations.jsonl.
        evaluation: The standard evaluation, or a shorter one.
        is_stored: Whether the evaluation comes from the run folder.
    """

    name: str
    config: Config
    versions: Mapping[str, str]
    policy: BaseAlgorithm
    curves: Mapping[str, Curve]
    evaluation: Evaluation
    is_stored: bool

    @property
    def trained_steps(self) -> int:
        """Control steps of the training so far, by its files."""
        return int(max([self.policy.num_timesteps, *(curve.steps[-1] for curve in self.curves.values())]))

    @cached_property
    def summary(self) -> dict[str, Any]:
        return self.evaluation.summary()

    @property
    def action_names(self) -> Sequence[str]:
        """Names of the kinds of actions."""
        return self.evaluation.scene.actions.names

    @cached_property
    def action_shares(self) -> np.ndarray:
        """Share of each kind of action among the evaluation's steps, shape (kinds,)."""
        actions = np.concatenate([episode.actions for episode in self.evaluation.episodes])
        kinds = self.evaluation.scene.actions.kinds(actions)
        return np.bincount(kinds, minlength=len(self.action_names)) / len(kinds)

    @property
    def coverage(self) -> dict[str, float] | None:
        """How much of a table of states and actions was updated; None for other policies."""
        policy: Any = self.policy.policy
        if not hasattr(policy, "visits"):
            return None
        visits = policy.visits.numpy()
        updated = visits > 0
        return {
            "states": len(visits),
            "visited_states": updated.any(axis=1).mean(),
            "updated_pairs": updated.mean(),
            "median_updates": float(np.median(visits[updated])) if updated.any() else 0.0,
        }


@dataclass(frozen=True)
class RunGroup:
    """Runs that differ only in their seed."""

    name: str
    colour: str
    views: Sequence[RunView]

    @property
    def config(self) -> Config:
        """The config of the first run; the others differ only in the seed."""
        return self.views[0].config

    @property
    def seeds(self) -> list[int]:
        return [view.config.train.seed for view in self.views]

    @property
    def trained_steps(self) -> list[int]:
        """Control steps of the shortest and of the longest training, once if they are equal."""
        steps = [view.trained_steps for view in self.views]
        return sorted({min(steps), max(steps)})

    @property
    def settings(self) -> dict[str, str]:
        """All settings and the versions of the packages, by dotted key."""
        seeds = ", ".join(map(str, self.seeds))
        return {**_flat(self.config.to_dict()), "train.seed": seeds, **_flat({"version": self.views[0].versions})}

    def mean(self, key: str) -> tuple[float, tuple[float, float]]:
        """Mean over the runs and its 95 % bootstrap interval, for a key of `Evaluation.summary`."""
        values = [view.summary[key] for view in self.views]
        return float(np.mean(values)), bootstrap_interval(values)


def run_folders(references: Sequence[str]) -> list[Path]:
    """The folders of the runs that references name, without duplicates.

    Args:
        references: Run folders, folders of run folders, or policies of the zoo or the hub.

    Raises:
        InputError: If a reference names no run.
    """
    return list(dict.fromkeys(folder.resolve() for reference in references for folder in _folders(reference)))


def _folders(reference: str) -> list[Path]:
    if reference.startswith(("zoo:", HUB)):
        return [checkpoint_file(reference).parents[1]]
    folder = Path(reference)
    if not folder.is_dir():
        raise InputError(f"there is no run folder {one_line(reference)}")
    if config_file(folder).is_file():
        return [folder]
    runs = sorted(file.parent for file in folder.glob("*/config.yaml"))
    if not runs:
        hint = next((f"; use {file.parent.parent}" for file in sorted(folder.rglob("config.yaml"))), "")
        raise InputError(f"{folder} is neither a run folder nor a folder of them: it has no config.yaml{hint}")
    return runs


def display_names(folders: Sequence[Path]) -> list[str]:
    """Names of runs on the page: references of zoo and hub, and other paths without their common part."""
    zoo = top_folder("zoo").resolve()
    known = {folder: f"zoo:{folder.name}" if folder.parent == zoo else cached_reference(folder) for folder in folders}
    shared = _common_path([str(folder.parent) for folder in folders if known[folder] is None])
    return [known[folder] or str(folder.relative_to(shared) if shared else folder) for folder in folders]


def _common_path(paths: Sequence[str]) -> str:
    try:
        return os.path.commonpath(paths)
    except ValueError:  # no paths, or on two drives of Windows
        return ""


def read_run_view(folder: Path, name: str, progress: bool = False, trust: bool = False) -> RunView:
    """Read a run folder, and evaluate a run that has no stored standard evaluation.

    Args:
        folder: The run folder.
        name: Name on the page.
        progress: Whether to show a progress bar if there is a terminal.
        trust: Import any module that a shared run names.

    Raises:
        InputError: If a file of the folder is missing or damaged.
    """
    run = Run.open(folder, trust)
    curves = read_curves(folder)
    goal_task = run.config.task.goal_task
    for metric in shown_metrics(goal_task=True):
        if metric.goals_only and not goal_task:
            curves.pop(metric.key, None)
    policy = load(folder, trust)
    trained, found = ({**config.to_dict(), "train": None} for config in (config_of(policy), run.config))
    if trained != found:
        raise InputError(f"{folder}: {config_file(folder).name} is not the config that its policy was trained with")
    is_stored = run.has_evaluation
    evaluation = kept_evaluation(run) if is_stored else evaluate(policy, episodes=_EPISODES, progress=progress)
    versions = {str(key): str(value) for key, value in (read_config(folder).get("versions") or {}).items()}
    return RunView(name, run.config, versions, policy, curves, evaluation, is_stored)


def group_runs(views: Iterable[RunView]) -> list[RunGroup]:
    """Group runs that differ only in their seed, sorted by seed.

    Raises:
        InputError: If two runs have the same seed as well, because a mean would count one training twice.
    """
    groups: dict[str, dict[int, RunView]] = {}
    for view in views:
        unseeded = replace(view.config, train=replace(view.config.train, seed=0))
        settings = {**unseeded.to_dict(), "versions": view.versions}
        seeds = groups.setdefault(json.dumps(settings, sort_keys=True), {})
        other = seeds.setdefault(view.config.train.seed, view)
        if other is not view:
            raise InputError(f"{other.name} and {view.name} are the same training: name one of them")
    names = [view.name for seeds in groups.values() for view in seeds.values()]
    colours = distinct_colours(len(groups), GROUP_COLOURS)
    return [
        RunGroup(_group_name([view.name for view in seeds.values()], names), colour, [seeds[i] for i in sorted(seeds)])
        for seeds, colour in zip(groups.values(), colours, strict=True)
    ]


def _group_name(names: Sequence[str], all_names: Sequence[str]) -> str:
    """The common path of names, or the first name if other names have the same path."""
    shared = _common_path(names)
    inside = [name for name in all_names if shared and Path(name).is_relative_to(shared)]
    return shared if len(names) == 1 or inside == list(names) else f"{names[0]} and {len(names) - 1} more"


def differences(groups: Sequence[RunGroup]) -> dict[str, list[str]]:
    """Settings in which groups differ, by dotted key, with the value of each group."""
    settings = [group.settings for group in groups]
    keys = sorted({key for each in settings for key in each} - {"train.seed"})
    rows = {key: [each.get(key, "") for each in settings] for key in keys}
    return {key: values for key, values in rows.items() if len(set(values)) > 1}


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Values of a nested mapping as text, by dotted key."""
    flat: dict[str, str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = "none" if value is None else str(value)
    return flat
