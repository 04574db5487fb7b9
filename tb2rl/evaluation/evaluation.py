"""The result of an evaluation: its episodes, its conditions, and the figures of its metrics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.values import Count, checked, type_with_checks
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Episode
from tb2rl.evaluation.metrics import figures, shown_metrics
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.folder import EVALUATION, Run
from tb2rl.runs.versions import versions
from tb2rl.simulation import find_simulator
from tb2rl.tasks import Task

_ARRAYS = ("path", "actions")
_FIGURES = tuple(field.name for field in fields(Episode) if field.name not in _ARRAYS)


@dataclass(frozen=True)
class Evaluation:
    """The episodes of a policy and their conditions.

    Attributes:
        episodes: At least one.
        scene: The task and the worlds; its time limit is that of the episodes.
        seed: Of the initial states and of all noise.
        simulation: Name of the simulator.
    """

    episodes: Sequence[Episode]
    scene: Scene
    seed: int
    simulation: str

    def __repr__(self) -> str:
        """The table of `rows`, for notebooks and `print`."""
        rows = [(f"{len(self.episodes)} episodes of at most {self.steps} steps", "value", ""), *self.rows()]
        first, second = (max(len(row[column]) for row in rows) for column in (0, 1))
        return "\n".join(f"{name:{first}}  {value:>{second}}  {more}".rstrip() for name, value, more in rows)

    @property
    def task(self) -> Task:
        """The task, with the time limit of the episodes."""
        return self.scene.task

    @property
    def steps(self) -> int:
        """Time limit of an episode [control steps]."""
        return self.task.episode_steps

    def summary(self) -> dict[str, Any]:
        """Conditions, figures of all metrics, and counts of endings, as JSON keeps them."""
        return {
            "episodes": len(self.episodes),
            "steps": self.steps,
            "seed": self.seed,
            "simulation": self.simulation,
            **figures(self.episodes, self.task.control_period),
            "endings": dict(sorted(Counter(self._each("ended")).items())),
        }

    def rows(self) -> list[tuple[str, str, str]]:
        """The table: label, figure, and unit with spread or interval."""
        summary = self.summary()
        endings = ", ".join(f"{ended} {count}" for ended, count in summary["endings"].items())
        return [*(metric.row(summary) for metric in shown_metrics(self.task.goal_task)), ("endings", "", endings)]

    @property
    def score(self) -> tuple[float, float]:
        """By which checkpoints are compared: the success rate, then the mean return.

        Rates of the same half percent are equal, because one episode of a thousand more is chance, and a training would
        keep a slow policy for it.
        """
        half_percents = round(200 * float(np.mean(self._each("success"))))
        return half_percents / 200, float(np.mean(self._each("episode_return")))

    @property
    def good_rate(self) -> float:
        """The share of episodes that reach the goal or, at a task without one, do not fail."""
        good = self._each("success") if self.task.goal_task else [not failed for failed in self._each("failed")]
        return float(np.mean(good))

    def tree(self, config: Config, policy: str) -> tuple[dict[str, Any], dict[str, list[np.ndarray]]]:
        """All of it for a run folder, see `Run.write_evaluation` and `kept_evaluation`.

        Args:
            config: Of the policy's training.
            policy: Its name, or that of its file.

        Returns:
            Plain values: the summary, the conditions, and every episode as "each"; and the arrays of the episodes.
        """
        each = [{name: getattr(episode, name) for name in _FIGURES} for episode in self.episodes]
        about = {"policy": policy, "config": config.to_dict(), "versions": versions()}
        return {**self.summary(), **about, "each": each}, {name: self._each(name) for name in _ARRAYS}

    def _each(self, name: str) -> list[Any]:
        return [getattr(episode, name) for episode in self.episodes]


def kept_evaluation(run: Run) -> Evaluation:
    """The standard evaluation that a run folder keeps.

    Raises:
        InputError: If there is none, its files are damaged or do not belong together, or it is not of the run's task.
    """
    tree, arrays = run.read_evaluation()
    try:
        episodes = _episodes_from(tree["each"], arrays)
        steps, seed = checked(Count, tree["steps"], "steps"), checked(int, tree["seed"], "seed")
        simulation = find_simulator(tree["simulation"]).name
        task = config_from(tree["config"]).task
    except (LookupError, TypeError, ValueError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{run.folder / EVALUATION} is not an evaluation: {error!s}")) from None
    if task != run.config.task:
        raise InputError(f"{run.folder}: {EVALUATION} is not of the task in config.yaml")
    scene = run.config.scene.worlds_for("test").with_time_limit(steps)
    if any(episode.actions.shape[1:] != scene.action_space.shape for episode in episodes):
        raise InputError(f"{run.folder}: {EVALUATION} has other actions than the task in config.yaml")
    if any(episode.world >= len(scene.spec.worlds) for episode in episodes):
        raise InputError(f"{run.folder}: {EVALUATION} has more worlds than the task in config.yaml")
    return Evaluation(episodes, scene, seed, simulation)


def _episodes_from(each: Sequence[Mapping[str, Any]], arrays: Mapping[str, Sequence[np.ndarray]]) -> list[Episode]:
    columns = [arrays[name] for name in _ARRAYS]
    trees = [{**figures, **dict(zip(_ARRAYS, row, strict=True))} for figures, *row in zip(each, *columns, strict=True)]
    episodes: list[Episode] = checked(list[type_with_checks(Episode)], trees, "each")  # type: ignore[misc]
    fits = [(e.path.shape, len(e.actions)) == ((e.length + 1, 2), e.length) for e in episodes]
    if not episodes or not all(fits):
        raise ValueError("its episodes have other lengths than their paths and actions")
    return episodes
