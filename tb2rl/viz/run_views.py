"""The data of runs for the report, and groups of runs that differ only in their seed."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from tensorboard.backend.event_processing.event_accumulator import SCALARS, EventAccumulator

from tb2rl.core import InputError, one_line, top_folder
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation, load_evaluation
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.evaluation.sim_to_sim import SimToSim, load_sim_to_sim
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs import HUB, TRAINING_EVALUATIONS, Config, Run, flatten, read_lines
from tb2rl.runs.folder import config_file, read_config
from tb2rl.runs.loading import cached_reference, checkpoint_file, config_of, load
from tb2rl.simulation import find_simulator
from tb2rl.viz.charts import GROUP_COLOURS, Curve, distinct_colours

_IDENTITY = ("agent_name", "task_name", "task", "observation")  # fields of the config by which a policy fits it
_EPISODES = 20  # number of episodes of an evaluation for the report
TRAINING_CURVES = {  # by TensorBoard tag: title, label of the y axis, whether the values are rates
    "rollout/ep_rew_mean": ("Return in training (exploring policy)", "return of an episode", False),
    "rollout/ep_len_mean": ("Length in training (exploring policy)", "steps of an episode", False),
    "rollout/failure_rate": ("Failures in training (exploring policy)", "failed episodes", True),
}


@dataclass(frozen=True)
class RunView:
    """The data of a run for the report."""

    name: str  # name in the report
    config: Config
    versions: Mapping[str, str]  # versions of the packages during the training
    policy: BaseAlgorithm  # the best policy
    curves: Mapping[str, Curve]  # see `read_curves`
    evaluation: Evaluation  # the standard evaluation if it is stored, else a shorter one
    is_stored: bool  # whether the run folder contains the evaluation
    sim_to_sim: SimToSim | None = None  # comparison of physics simulators; None: the run folder has none

    @property
    def trained_steps(self) -> int:
        """Control steps of the training so far, which may be more than those of the best policy."""
        return int(max([self.policy.num_timesteps, *(curve.steps[-1] for curve in self.curves.values())]))

    @property
    def is_in_physics(self) -> bool:
        """Whether the evaluation was in a physics simulator."""
        return find_simulator(self.evaluation.simulation).is_physics

    @property
    def settings(self) -> dict[str, str]:
        """All settings and the versions of the packages, by dotted key."""
        leaves = flatten({**self.config.to_dict(), "version": self.versions})
        return {key: "none" if value is None else str(value) for key, value in leaves.items()}

    @cached_property
    def summary(self) -> dict[str, Any]:
        return self.evaluation.summary()

    @cached_property
    def action_shares(self) -> np.ndarray:
        """Share of each kind of action among the evaluation's steps, shape (kinds,)."""
        actions = self.evaluation.scene.actions
        kinds = actions.kinds(np.concatenate([episode.actions for episode in self.evaluation.episodes]))
        return np.bincount(kinds, minlength=len(actions.names)) / len(kinds)

    @property
    def coverage(self) -> dict[str, float] | None:
        """State count, shares of visited states and updated pairs, median updates of these pairs; None: no Q-table."""
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
    def seeds(self) -> list[int]:
        """The seeds of the runs, ascending."""
        return [view.config.train.seed for view in self.views]

    @property
    def settings(self) -> dict[str, str]:
        """All settings and the versions of the packages, by dotted key."""
        return {**self.views[0].settings, "train.seed": ", ".join(map(str, self.seeds))}

    def mean(self, key: str) -> tuple[float, tuple[float, float]]:
        """Mean over the runs of the value `key` of `Evaluation.summary`, and its 95 % bootstrap interval."""
        values = [view.summary[key] for view in self.views]
        return float(np.mean(values)), bootstrap_interval(values)


def run_folders(references: Sequence[str]) -> list[Path]:
    """Find run folders, without duplicates.

    Args:
        references: Run folders, folders that contain run folders, or policies of the zoo or the hub.

    Raises:
        InputError: If a reference has no run.
    """
    return list(dict.fromkeys(folder.resolve() for reference in references for folder in _find_folders(reference)))


def _find_folders(reference: str) -> list[Path]:
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
        raise InputError(f"{folder} is neither a run folder nor contains run folders: it has no config.yaml{hint}")
    return runs


def display_names(folders: Sequence[Path]) -> list[str]:
    """Names of runs in the report: a reference to the zoo or the hub, or the path relative to the common folder."""
    zoo = top_folder("zoo").resolve()
    references = {path: f"zoo:{path.name}" if path.parent == zoo else cached_reference(path) for path in folders}
    common = _common_path([str(folder.parent) for folder in folders if references[folder] is None])
    return [references[folder] or str(folder.relative_to(common) if common else folder) for folder in folders]


def _common_path(paths: Sequence[str]) -> str:
    try:
        return os.path.commonpath(paths)
    except ValueError:  # there are no paths, or they are on different drives of Windows
        return ""


def read_run_view(folder: Path, name: str, progress_bar: bool = False, trust: bool = False) -> RunView:
    """Read a run folder, and evaluate the run if there is no stored standard evaluation.

    Args:
        folder: The run folder.
        name: The name in the report.
        progress_bar: Whether to show a progress bar if there is a terminal.
        trust: See `Run.open`.

    Raises:
        InputError: If a file of the folder is missing or damaged, or the config is not that of the policy.
    """
    run = Run.open(folder, trust)
    curves, policy = read_curves(folder, run.config.task.goal_task), load(folder, trust)
    # Not `train`, because a resume may have raised the total in the config since the best policy was saved.
    if any(getattr(config_of(policy), name) != getattr(run.config, name) for name in _IDENTITY):
        raise InputError(f"{folder}: {config_file(folder).name} differs from the config in the policy's checkpoint")
    is_stored = run.has_evaluation_episodes
    evaluation = load_evaluation(run) if is_stored else evaluate(policy, episodes=_EPISODES, progress_bar=progress_bar)
    versions = {str(key): str(value) for key, value in (read_config(folder).get("versions") or {}).items()}
    comparison = load_sim_to_sim(run)
    return RunView(name, run.config, versions, policy, curves, evaluation, is_stored, comparison)


def read_curves(folder: Path, goal_task: bool) -> dict[str, Curve]:
    """Read the existing curves of a run folder, by TensorBoard tag or by key of a metric.

    Raises:
        InputError: If the file of the evaluations during training is damaged.
    """
    points = {}
    if (folder / "tensorboard").is_dir():
        events = EventAccumulator(str(folder / "tensorboard"), size_guidance={SCALARS: 0}).Reload()  # 0: no limit
        tags = [tag for tag in TRAINING_CURVES if tag in events.Tags()[SCALARS]]
        points = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in tags}
    file = folder / TRAINING_EVALUATIONS
    lines = read_lines(file) if file.is_file() else []
    keys = [metric.key for metric in shown_metrics(goal_task) if metric.statistic == "rate" and lines]
    try:
        points |= {key: [(line["timesteps"], line[key]) for line in lines] for key in keys}
        tables = {key: np.asarray_chkfinite(rows, dtype=float) for key, rows in points.items()}
        return {key: Curve(*rows[np.argsort(rows[:, 0], kind="stable")].T) for key, rows in tables.items()}
    except (LookupError, OverflowError, TypeError, ValueError) as error:
        raise InputError(one_line(f"{file} is damaged: {error!r}")) from None


def group_runs(views: Iterable[RunView]) -> list[RunGroup]:
    """Group runs that differ only in their seed, and sort each group by seed.

    Raises:
        InputError: If two runs differ in nothing, because a mean would count the same training twice.
    """
    views_by_seed: dict[frozenset[tuple[str, str]], dict[int, RunView]] = {}
    for view in views:
        group = views_by_seed.setdefault(frozenset({**view.settings, "train.seed": ""}.items()), {})
        other = group.setdefault(view.config.train.seed, view)
        if other is not view:
            raise InputError(f"{other.name} and {view.name} are the same training; give only one of them")
    groups = [[group[seed] for seed in sorted(group)] for group in views_by_seed.values()]
    colours = distinct_colours(len(groups), GROUP_COLOURS)
    return [RunGroup(_group_name(i, groups), colours[i], group) for i, group in enumerate(groups)]


def _group_name(index: int, groups: Sequence[Sequence[RunView]]) -> str:
    """The common path of the group's names; "NAME and N more" if there is none, or other groups lie in it."""
    group, others = groups[index], [view for other in (*groups[:index], *groups[index + 1 :]) for view in other]
    common = _common_path([view.name for view in group])
    is_unique = common and not any(Path(other.name).is_relative_to(common) for other in others)
    return common if len(group) == 1 or is_unique else f"{group[0].name} and {len(group) - 1} more"


def differences(groups: Sequence[RunGroup]) -> dict[str, list[str]]:
    """Settings, except the seed, in which groups differ, by dotted key, with the value of each group."""
    settings = [group.settings for group in groups]
    rows = {key: [s.get(key, "") for s in settings] for key in sorted(set().union(*settings) - {"train.seed"})}
    return {key: values for key, values in rows.items() if len(set(values)) > 1}
