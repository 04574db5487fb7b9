"""The list of metrics that tables, JSON files, TensorBoard, reports and the zoo's cards show."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tb2rl.evaluation.episodes import Episode
from tb2rl.evaluation.statistics import wilson_interval


@dataclass(frozen=True)
class Metric:
    """A statistic of the episodes of an evaluation.

    Attributes:
        name: Keys in JSON are NAME_rate and NAME_interval for a rate, mean_NAME and std_NAME for a mean, else NAME.
        label: Label in tables.
        unit: Unit in tables, or "".
        value: Function from an episode to its value.
        statistic: Statistic of the values: a "rate" with its 95 % interval, a "mean" with the standard deviation, the
            "median", or the sum "per second" of simulated time.
        goal_tasks_only: Whether tables show the metric only for tasks with a goal.
        filters_only: Whether tables show the metric only for tasks with filters.
        is_shown: Whether tables, charts and TensorBoard show the metric; JSON files always contain it.
    """

    name: str
    label: str
    unit: str
    value: Callable[[Episode], float]
    statistic: Literal["rate", "mean", "median", "per second"] = "mean"
    goal_tasks_only: bool = False
    filters_only: bool = False
    is_shown: bool = True

    @property
    def key(self) -> str:
        """The key of the statistic in the result of `figures`, and in files."""
        return {"rate": f"{self.name}_rate", "mean": f"mean_{self.name}"}.get(self.statistic, self.name)

    def figures(self, episodes: Sequence[Episode], control_period: float) -> dict[str, Any]:
        """The statistic, and its interval or standard deviation, by key."""
        values = [self.value(episode) for episode in episodes]
        if self.statistic == "rate":
            interval = wilson_interval(sum(map(bool, values)), len(values))
            return {self.key: float(np.mean(values)), f"{self.name}_interval": interval}
        if self.statistic == "mean":
            return {self.key: float(np.mean(values)), f"std_{self.name}": float(np.std(values))}
        if self.statistic == "per second":
            return {self.key: sum(values) / sum(episode.length * control_period for episode in episodes)}
        return {self.key: float(np.median(values))}

    def format(self, figure: float) -> str:
        """The statistic as text, rates in percent."""
        if self.statistic == "rate":
            return f"{100 * figure:.1f} %"
        if self.statistic == "median":  # of counts: usually an integer, but not its mean over seeds
            return f"{figure:.1f}".removesuffix(".0")
        return f"{figure:{'.3f' if self.statistic == 'per second' else '.1f'}}"

    def spread(self, figures: Mapping[str, Any]) -> str:
        """The 95 % interval of a rate or the standard deviation of a mean as text, else ""."""
        if self.statistic == "rate":
            low, high = figures[f"{self.name}_interval"]
            return f"{100 * low:.1f} to {100 * high:.1f} %"
        return f"\u00b1 {figures[f'std_{self.name}']:.1f}" if self.statistic == "mean" else ""

    def row(self, figures: Mapping[str, Any]) -> tuple[str, str, str]:
        """Label, statistic, and spread with unit, for a table."""
        prefix = "95 % interval " if self.statistic == "rate" else ""
        return self.label, self.format(figures[self.key]), f"{prefix}{self.spread(figures)} {self.unit}".strip()


def _count_squares(path: np.ndarray) -> int:
    """Number of squares of 1 m that contain points of a path x, y [m], shape (n, 2)."""
    x, y = np.floor(path).astype(np.int64).T
    return len(np.unique(x * 2**31 + y))  # faster than np.unique(axis=0)


METRICS = (
    Metric("failure_free", "failure-free", "", lambda episode: not episode.failed, "rate"),
    Metric("success", "goal reached", "", lambda episode: episode.success, "rate", goal_tasks_only=True),
    # `touched`: the bumper was pressed; not every task regards this as a failure.
    Metric("touch_free", "touch-free", "", lambda episode: not episode.touched, "rate", is_shown=False),
    Metric("distance", "distance", "m", lambda episode: episode.distance),
    Metric("return", "return", "", lambda episode: episode.episode_return),
    Metric("length", "length", "steps", lambda episode: episode.length),
    Metric("mean_speed", "speed", "m/s", lambda episode: episode.distance, "per second"),
    Metric("filtered", "changed by filters", "% of steps", lambda episode: episode.filtered_share, filters_only=True),
    # Few visited squares reveal a robot that only drives in circles.
    Metric("median_squares", "visited", "squares of 1 m (median)", lambda e: _count_squares(e.path), "median"),
)


def spinning_speed(max_speed: float) -> float:
    """The mean speed [m/s] below which a robot spins; `max_speed` [m/s] is that of its commands.

    In turns the tutorial's robot drives at 0.05 m/s. Some robots are so slow that 0.08 m/s is much for them.
    """
    return min(0.08, 0.4 * max_speed)


def criterion(goal_task: bool) -> Metric:
    """The rate by which an episode is good: success for tasks with a goal, else no failure."""
    return next(metric for metric in METRICS if metric.name == ("success" if goal_task else "failure_free"))


def figures(episodes: Sequence[Episode], control_period: float) -> dict[str, Any]:
    """The figures of all metrics, by key."""
    return {key: figure for metric in METRICS for key, figure in metric.figures(episodes, control_period).items()}


def shown_metrics(goal_task: bool, has_filters: bool = False) -> list[Metric]:
    """The metrics that tables, charts and TensorBoard show, for tasks with or without a goal and filters."""
    shown = [metric for metric in METRICS if metric.is_shown and (has_filters or not metric.filters_only)]
    return [metric for metric in shown if goal_task or not metric.goal_tasks_only]
