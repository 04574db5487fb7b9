"""The runs that a report shows: found by what the user names, read from their folders, evaluated where need be."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import top_folder
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation, kept_evaluation
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run, config_file, read_config
from tb2rl.runs.hub import HUB, cached_reference
from tb2rl.runs.loading import checkpoint_file, config_of, load
from tb2rl.viz.curves import Curve, read_curves

_EPISODES = 20  # of an evaluation that is made for the page


@dataclass(frozen=True)
class Subject:
    """A run, read for the page.

    Attributes:
        name: What the page calls it.
        config: What it was trained to do.
        versions: Of what trained it.
        policy: The one that stands for it.
        curves: Figures over its training, by the tag in TensorBoard or the key in evaluations.jsonl.
        evaluation: The standard one, or a shorter one.
        kept: Whether the evaluation is the one in the run folder.
    """

    name: str
    config: Config
    versions: Mapping[str, str]
    policy: BaseAlgorithm
    curves: Mapping[str, Curve]
    evaluation: Evaluation
    kept: bool

    @property
    def scene(self) -> Scene:
        """What its evaluation drove in."""
        return self.evaluation.scene

    @property
    def trained(self) -> int:
        """Control steps of the training, as far as its files tell; an unfinished one has fewer than its config."""
        return int(max([self.policy.num_timesteps, *(curve.steps[-1] for curve in self.curves.values())]))

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The figures of the evaluation."""
        return self.evaluation.summary()

    @property
    def failures(self) -> int:
        """How many episodes of the evaluation failed."""
        return sum(episode.failed for episode in self.evaluation.episodes)

    @property
    def action_names(self) -> Sequence[str]:
        """What the page calls the kinds of its actions."""
        return self.scene.actions.names

    @cached_property
    def action_shares(self) -> np.ndarray:
        """Share of the evaluation's steps that took each kind of action, shape (kinds,)."""
        taken = self.scene.actions.kinds(np.concatenate([episode.actions for episode in self.evaluation.episodes]))
        return np.bincount(taken, minlength=len(self.action_names)) / len(taken)

    @property
    def visits(self) -> np.ndarray | None:
        """Updates of each pair of state and action, shape (states, actions), of a policy that counts them."""
        visits = getattr(self.policy.policy, "visits", None)
        return None if visits is None else visits.numpy()

    @property
    def median_visits(self) -> float:
        """Of the pairs that were updated at all."""
        assert self.visits is not None
        updated = self.visits[self.visits > 0]
        return float(np.median(updated)) if updated.size else 0.0


def run_folders(references: Sequence[str]) -> list[Path]:
    """The run folders that references mean, each once: a run's, those in a folder of runs, or one of zoo or hub.

    Raises:
        InputError: If a reference means no run.
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
    inside = sorted(file.parent for file in folder.glob("*/config.yaml"))
    if not inside:
        deeper = next((f"; take {file.parent.parent}" for file in sorted(folder.rglob("config.yaml"))), "")
        raise InputError(f"{folder} is neither a run folder nor a folder of them: no config.yaml is in it{deeper}")
    return inside


def names_of(folders: Sequence[Path]) -> list[str]:
    """What the page calls runs: as zoo and hub do, and other folders what their paths do not have in common."""
    zoo = top_folder("zoo").resolve()
    known = {folder: f"zoo:{folder.name}" if folder.parent == zoo else cached_reference(folder) for folder in folders}
    shared = shared_path([str(folder.parent) for folder in folders if known[folder] is None])
    return [known[folder] or str(folder.relative_to(shared) if shared else folder) for folder in folders]


def shared_path(paths: Sequence[str]) -> str:
    """What paths begin with in common; "" where that is nothing, as on two drives of Windows."""
    try:
        return os.path.commonpath(paths)
    except ValueError:
        return ""


def read_subject(folder: Path, name: str, progress: bool = False, trust: bool = False) -> Subject:
    """Read a run folder; a run that has no standard evaluation with its paths is evaluated.

    Args:
        folder: Of the run.
        name: What the page is to call it.
        progress: Whether an evaluation draws a bar, where there is a terminal.
        trust: Whether to import whatever a run that somebody shared names.

    Raises:
        InputError: If the folder does not hold what it should.
    """
    run = Run.open(folder, trust)
    curves = read_curves(folder)
    if not run.config.task.goal_task:  # without a goal, to succeed is not to fail
        curves.pop("success_rate", None)
    policy = load(folder, trust)
    if _untrained(config_of(policy)) != _untrained(run.config):
        raise InputError(f"{folder}: {config_file(folder).name} is not what its policy was trained with")
    kept = run.has_evaluation
    evaluation = kept_evaluation(run) if kept else evaluate(policy, episodes=_EPISODES, progress=progress)
    return Subject(name, run.config, _versions(folder), policy, curves, evaluation, kept)


def _untrained(config: Config) -> dict[str, Any]:
    """What resuming a training cannot change."""
    return {key: value for key, value in config.to_dict().items() if key != "train"}


def _versions(folder: Path) -> dict[str, str]:
    versions = read_config(folder).get("versions", {})
    return {str(key): str(value) for key, value in versions.items()} if isinstance(versions, Mapping) else {}


def without_seed(subject: Subject) -> dict[str, Any]:
    """All that decided how a run was trained, but its seed."""
    config = replace(subject.config, train=replace(subject.config.train, seed=0))
    return {**config.to_dict(), "versions": subject.versions}
