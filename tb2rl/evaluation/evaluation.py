"""What a policy did from many start poses: the episodes, and the figures that say how good that is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge
from gymnasium import spaces

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.values import Count, NonNegative, checked, type_with_checks
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.rollout import Moment
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.robots.robot import RADIUS
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.folder import EVALUATION, Run
from tb2rl.runs.versions import versions
from tb2rl.simulation import Judge
from tb2rl.tasks import Task


@dataclass(frozen=True)
class Episode:
    """One evaluated episode; the return and the distance are sums over its steps."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    ended: str  # "collision", "goal", ..., "time limit"
    failed: bool  # whether that ending counts as failed
    success: bool
    touched: bool  # whether the bumper fired
    length: int  # control steps
    distance: float  # [m]
    episode_return: float
    path: np.ndarray  # x, y [m] at the start and after each step, shape (length + 1, 2), float32
    actions: np.ndarray  # of each step: shape (length,), whole numbers, or (length, 2), float32
    world: Annotated[int, Ge(0)] = 0  # index among those of the scene
    closest: NonNegative | None = None  # [m] from the hull to the nearest obstacle, at worst; None: not measured
    goal: tuple[float, float] | None = None  # x, y [m]; None: the task has none


_MEANS = (("distance", "m"), ("return", ""), ("length", "steps"))  # figures and their units
_ARRAYS = ("path", "actions")
_FIGURES = tuple(field.name for field in fields(Episode) if field.name not in _ARRAYS)


@dataclass(frozen=True)
class Evaluation:
    """What a policy did, and what it was asked to do.

    Attributes:
        episodes: At least one.
        scene: Where and at which task; its time limit is that of the episodes.
        seed: Of the start poses and of all noise.
        simulation: "bullet", or "kinematic": where PyBullet is missing, the fast twin is the judge.
    """

    episodes: Sequence[Episode]
    scene: Scene
    seed: int
    simulation: str = "bullet"

    def __repr__(self) -> str:
        """The table of `rows`, which a notebook and `print` show."""
        rows = [(f"{len(self.episodes)} episodes of at most {self.steps} steps", "value", ""), *self.rows()]
        first, second = (max(len(row[column]) for row in rows) for column in (0, 1))
        return "\n".join(f"{name:{first}}  {value:>{second}}  {more}".rstrip() for name, value, more in rows)

    @property
    def task(self) -> Task:
        """What the policy was asked to do."""
        return self.scene.task

    @property
    def steps(self) -> int:
        """Control steps at most in an episode."""
        return self.task.episode_steps

    def summary(self) -> dict[str, Any]:
        """The figures, for a table or a JSON file; speeds in m/s, distances in m, rates with 95 % intervals.

        `median_squares` is how many different squares of 1 m the median episode visits: circling visits few of them.
        """
        lengths, distances = self._each("length"), self._each("distance")
        return {
            "episodes": len(self.episodes),
            "steps": self.steps,
            "seed": self.seed,
            "simulation": self.simulation,
            **_rate("failure_free", [not failed for failed in self._each("failed")]),
            **_rate("success", self._each("success")),
            "touch_free_rate": float(np.mean([not touched for touched in self._each("touched")])),
            **_mean("distance", distances),
            **_mean("return", self._each("episode_return")),
            **_mean("length", lengths),
            "mean_speed": sum(distances) / (sum(lengths) * self.task.control_period),
            "median_squares": float(np.median([_squares(path) for path in self._each("path")])),
            "endings": dict(sorted(Counter(self._each("ended")).items())),
        }

    def rows(self) -> list[tuple[str, str, str]]:
        """The figures of `summary` in words: name, value, and unit with spread or interval."""
        summary = self.summary()
        rows = [("failure-free", *_rate_in_words(summary, "failure_free"))]
        if self.task.goal_task:
            rows.append(("goal reached", *_rate_in_words(summary, "success")))
        for name, unit in _MEANS:
            spread = f"± {summary[f'std_{name}']:.1f} {unit}".rstrip()
            rows.append((name, f"{summary[f'mean_{name}']:.1f}", spread))
        endings = ", ".join(f"{ended} {count}" for ended, count in summary["endings"].items())
        return [
            *rows,
            ("speed", f"{summary['mean_speed']:.3f}", "m/s"),
            ("visited", f"{summary['median_squares']:g}", "squares of 1 m (median)"),
            ("endings", "", endings),
        ]

    @property
    def score(self) -> tuple[float, float]:
        """What makes one evaluation better than another: the success rate, then the mean return.

        Rates of the same half percent count alike: to be one episode of a thousand better is chance, and a training
        would keep a slow policy for it.
        """
        half_percents = round(200 * float(np.mean(self._each("success"))))
        return half_percents / 200, float(np.mean(self._each("episode_return")))

    @property
    def good_rate(self) -> float:
        """The share of good episodes: those that reach the goal, or at a task without one those that do not fail."""
        good = self._each("success") if self.task.goal_task else [not failed for failed in self._each("failed")]
        return float(np.mean(good))

    def tree(self, config: Config, policy: str) -> tuple[dict[str, Any], dict[str, list[np.ndarray]]]:
        """All of it as a run folder keeps it, see `Run.write_evaluation` and `kept_evaluation`.

        Args:
            config: What the policy was trained to do.
            policy: Its name, or that of its file.

        Returns:
            Plain values: the figures, the conditions, and every episode as "each"; and the arrays of the episodes.
        """
        each = [{name: getattr(episode, name) for name in _FIGURES} for episode in self.episodes]
        about = {"policy": policy, "config": config.to_dict(), "versions": versions()}
        return {**self.summary(), **about, "each": each}, {name: self._each(name) for name in _ARRAYS}

    def _each(self, name: str) -> list[Any]:
        return [getattr(episode, name) for episode in self.episodes]


def episode_of(scene: Scene, moments: Sequence[Moment]) -> Episode:
    """What the moments of an episode came to."""
    first, last = moments[0], moments[-1]
    world = int(first.initial_state.world[0])
    places = [first.before[:2], *(moment.pose[:2] for moment in moments)]
    radius = float(last.initial_state.parameters[0, RADIUS])
    clearance = min(scene.spec.worlds[world].clearance(*place) for place in places)
    return Episode(
        start=tuple(first.before.tolist()),
        ended=last.info["ended"],
        failed=last.info["failed"],
        success=last.info["is_success"],
        touched=any(moment.info["bumped"] for moment in moments),
        length=last.step,
        distance=last.info["distance"],
        episode_return=last.total,
        path=np.array(places, dtype=np.float32),
        actions=np.array([moment.action for moment in moments], dtype=smallest_type(scene.action_space)),
        world=world,
        closest=max(clearance - radius, 0.0) if np.isfinite(clearance) else None,  # inf: there is no obstacle
        goal=tuple(last.initial_state.goal[0].tolist()) if scene.task.goal_task else None,
    )


def _squares(path: np.ndarray) -> int:
    """How many different squares of 1 m a path x, y [m], shape (n, 2), has points in."""
    x, y = np.floor(path).astype(np.int64).T
    return len(np.unique(x * 2**31 + y))  # one number for each square: faster than unique rows


def smallest_type(space: spaces.Space) -> np.dtype:
    """What keeps actions: the smallest integers that hold all named commands, or the type of the velocities."""
    return np.min_scalar_type(int(space.n) - 1) if isinstance(space, spaces.Discrete) else np.dtype(space.dtype)


def _rate(name: str, counted: Sequence[bool]) -> dict[str, Any]:
    interval = wilson_interval(sum(counted), len(counted))
    return {f"{name}_rate": float(np.mean(counted)), f"{name}_interval": interval}


def _rate_in_words(summary: Mapping[str, Any], name: str) -> tuple[str, str]:
    low, high = summary[f"{name}_interval"]
    return f"{100 * summary[f'{name}_rate']:.1f} %", f"95 % interval {100 * low:.1f} to {100 * high:.1f} %"


def _mean(name: str, values: Sequence[float]) -> dict[str, float]:
    return {f"mean_{name}": float(np.mean(values)), f"std_{name}": float(np.std(values))}


def kept_evaluation(run: Run) -> Evaluation:
    """The standard evaluation that a run folder keeps.

    Raises:
        InputError: If there is none, its files are damaged or do not belong together, or it is not of the run's task.
    """
    tree, arrays = run.read_evaluation()
    try:
        episodes = _episodes_from(tree["each"], arrays)
        steps, seed = checked(Count, tree["steps"], "steps"), checked(int, tree["seed"], "seed")
        simulation = checked(Judge, tree.get("simulation", "bullet"), "simulation")  # older files do not say it
        task = config_from(tree["config"]).task
    except (LookupError, TypeError, ValueError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{run.folder / EVALUATION} is not an evaluation: {error!s}")) from None
    if task != run.config.task:
        raise InputError(f"{run.folder}: {EVALUATION} is not of the task in config.yaml")
    scene = run.config.scene.worlds_for("test").changed(episode_steps=steps)
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
