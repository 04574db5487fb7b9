"""The result of an evaluation, and how a run folder stores it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.values import Count, checked, type_with_checks
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Episode
from tb2rl.evaluation.metrics import criterion, figures, shown_metrics, spinning_speed
from tb2rl.runs import EVALUATION, Config, Run, config_from, versions
from tb2rl.simulation import find_simulator
from tb2rl.tasks import Task

_ARRAYS = ("path", "actions")  # fields of `Episode` that a run folder stores as arrays
# At most so many squares of 1 m are visited by a robot that spins, and it could have driven so far [m].
_SPINNING_SQUARES, _SPINNING_REACH = 4, 15.0
_PLAIN_FIELDS = tuple(field.name for field in fields(Episode) if field.name not in _ARRAYS)


@dataclass(frozen=True)
class Evaluation:
    """The episodes of a policy.

    Attributes:
        episodes: At least one.
        scene: The task, with the time limit of the episodes, and the worlds.
        seed: Seed of the initial states and of all noise.
        simulation: Name of the simulator.
    """

    episodes: Sequence[Episode]
    scene: Scene
    seed: int
    simulation: str

    def __repr__(self) -> str:
        """The table of `rows`, for notebooks and `print`."""
        rows = [(f"{len(self.episodes)} episodes of at most {self.steps} steps", "value", ""), *self.rows()]
        label_width, value_width = (max(len(row[column]) for row in rows) for column in (0, 1))
        lines = (f"{label:{label_width}}  {value:>{value_width}}  {spread}" for label, value, spread in rows)
        return "\n".join(line.rstrip() for line in lines)

    @property
    def task(self) -> Task:
        return self.scene.task

    @property
    def steps(self) -> int:
        """Time limit of an episode [control steps]."""
        return self.task.episode_steps

    def summary(self) -> dict[str, Any]:
        """Options of the evaluation, figures of all metrics, and counts of the endings, for JSON."""
        return {
            "episodes": len(self.episodes),
            "steps": self.steps,
            "seed": self.seed,
            "simulation": self.simulation,
            **figures(self.episodes, self.task.control_period),
            "endings": dict(sorted(Counter(self._column("ended")).items())),
        }

    def rows(self) -> list[tuple[str, str, str]]:
        """Rows of a table: label, figure, and spread or interval with the unit."""
        summary = self.summary()
        endings = ", ".join(f"{ended} {count}" for ended, count in summary["endings"].items())
        shown = shown_metrics(self.task.goal_task, bool(self.task.filters))
        return [*(metric.row(summary) for metric in shown), ("endings", "", endings)]

    @property
    def score(self) -> tuple[float, float]:
        """Rounded success rate and mean return, by which training compares policies, see `train.best_by`.

        Success rates are rounded to half percents, so that one more success in a thousand episodes, which is chance,
        does not outweigh a higher return.
        """
        success_rate, mean_return = (float(np.mean(self._column(name))) for name in ("success", "episode_return"))
        return round(200 * success_rate) / 200, mean_return

    @property
    def good(self) -> np.ndarray:
        """Whether each episode is good by the `criterion` of the task, bool, shape (episodes,)."""
        metric = criterion(self.task.goal_task)
        return np.array([metric.value(episode) for episode in self.episodes], dtype=bool)

    @property
    def good_rate(self) -> float:
        return float(np.mean(self.good))

    @cached_property
    def spins(self) -> bool:
        """Whether the robot survives by staying where it is, at a task without a goal, though it had time to leave."""
        summary, max_speed = self.summary(), self.scene.actions.max_speed
        reach = summary["mean_length"] * self.task.control_period * max_speed  # [m]
        is_slow = summary["mean_speed"] < spinning_speed(max_speed)
        is_local = reach > _SPINNING_REACH and (is_slow or summary["median_squares"] <= _SPINNING_SQUARES)
        return not self.task.goal_task and summary["failure_free_rate"] > 0.5 and is_local

    def serialize(self, config: Config, policy: str) -> tuple[dict[str, Any], dict[str, list[np.ndarray]]]:
        """The content of the files that `Run.write_evaluation` writes and `load_evaluation` reads.

        Args:
            config: The config of the policy's training.
            policy: Name or file of the policy.

        Returns:
            Plain values with all episodes under the key "each", and the arrays of the episodes by name.
        """
        episodes = [{name: getattr(episode, name) for name in _PLAIN_FIELDS} for episode in self.episodes]
        origin = {"policy": policy, "config": config.to_dict(), "versions": versions()}
        return {**self.summary(), **origin, "each": episodes}, {name: self._column(name) for name in _ARRAYS}

    def _column(self, name: str) -> list[Any]:
        return [getattr(episode, name) for episode in self.episodes]


def load_evaluation(run: Run) -> Evaluation:
    """Load the standard evaluation of a run folder.

    Raises:
        InputError: If there is none, its files are damaged or inconsistent, or it belongs to another task.
    """
    tree, arrays = run.read_evaluation()
    try:
        stored_rows = zip(tree["each"], *(arrays[name] for name in _ARRAYS), strict=True)
        fields_of_episodes = [{**plain, **dict(zip(_ARRAYS, values, strict=True))} for plain, *values in stored_rows]
        episodes: list[Episode] = checked(list[type_with_checks(Episode)], fields_of_episodes, "each")  # type: ignore[misc]
        scene = run.config.scene.for_purpose("test").with_time_limit(checked(Count, tree["steps"], "steps"))
        if config_from(tree["config"]).task != run.config.task or not _fit_scene(episodes, scene):
            raise ValueError("its task or its episodes do not match the task in config.yaml")
        seed, simulation = checked(int, tree["seed"], "seed"), find_simulator(tree["simulation"]).name
    except (LookupError, TypeError, ValueError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{run.folder / EVALUATION} is not an evaluation of this run: {error!s}")) from None
    return Evaluation(episodes, scene, seed, simulation)


def _fit_scene(episodes: Sequence[Episode], scene: Scene) -> bool:
    """Whether there are episodes, and the shapes of their arrays and their worlds fit a scene."""
    return bool(episodes) and all(
        episode.path.shape == (episode.length + 1, 2)
        and episode.actions.shape == (episode.length, *(scene.action_space.shape or ()))
        and episode.world < len(scene.spec.worlds)
        for episode in episodes
    )
