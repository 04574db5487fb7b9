"""The metrics of an evaluation: the one list from which tables, JSON, TensorBoard, pages and cards are made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tb2rl.evaluation.episodes import Episode
from tb2rl.evaluation.statistics import wilson_interval


@dataclass(frozen=True)
class Metric:
    """A figure of an evaluation.

    Attributes:
        name: Its key; a rate has the keys NAME_rate and NAME_interval, a mean mean_NAME and std_NAME, others NAME.
        label: In tables.
        unit: Of the figure, "" for none.
        value: Of one episode, from the episode and its duration [s].
        kind: "rate" of episodes, with its 95 % interval; "mean" with standard deviation; "median"; "ratio" of the sum
            of values to the sum of `per`.
        per: Divisor of a ratio, from the same.
        higher_is_better: None: neither is better.
        goals_only: Whether only tasks with a goal show it in tables.
        in_tables: Whether tables show it at all.
    """

    name: str
    label: str
    unit: str
    value: Callable[[Episode, float], float]
    kind: Literal["rate", "mean", "median", "ratio"] = "mean"
    per: Callable[[Episode, float], float] | None = None
    higher_is_better: bool | None = True
    goals_only: bool = False
    in_tables: bool = True

    @property
    def key(self) -> str:
        """The key of its main figure in `figures`."""
        return {"rate": f"{self.name}_rate", "mean": f"mean_{self.name}"}.get(self.kind, self.name)

    def figures(self, episodes: Sequence[Episode], control_period: float) -> dict[str, Any]:
        """The figure and its spread, by their keys."""
        durations = [episode.length * control_period for episode in episodes]
        values = [self.value(episode, time) for episode, time in zip(episodes, durations, strict=True)]
        if self.kind == "rate":
            interval = wilson_interval(sum(map(bool, values)), len(values))
            return {self.key: float(np.mean(values)), f"{self.name}_interval": interval}
        if self.kind == "mean":
            return {self.key: float(np.mean(values)), f"std_{self.name}": float(np.std(values))}
        if self.per is not None:
            return {self.key: sum(values) / sum(map(self.per, episodes, durations))}
        return {self.key: float(np.median(values))}

    def format(self, figure: float) -> str:
        """A figure as text, rates in percent."""
        if self.kind == "rate":
            return f"{100 * figure:.1f} %"
        return f"{figure:.1f}" if self.kind == "mean" else f"{figure:.3f}" if self.kind == "ratio" else f"{figure:g}"

    def spread(self, figures: Mapping[str, Any]) -> str:
        """The 95 % interval of a rate or the standard deviation of a mean; else ""."""
        if self.kind == "rate":
            low, high = figures[f"{self.name}_interval"]
            return f"{100 * low:.1f} to {100 * high:.1f} %"
        return f"\u00b1 {figures[f'std_{self.name}']:.1f}" if self.kind == "mean" else ""

    def row(self, figures: Mapping[str, Any]) -> tuple[str, str, str]:
        """Label, figure, and spread with unit, for a table."""
        spread = f"95 % interval {self.spread(figures)}" if self.kind == "rate" else self.spread(figures)
        return self.label, self.format(figures[self.key]), f"{spread} {self.unit}".strip()


def squares(path: np.ndarray) -> int:
    """Number of squares of 1 m that a path x, y [m], shape (n, 2), has points in."""
    x, y = np.floor(path).astype(np.int64).T
    return len(np.unique(x * 2**31 + y))  # one number for each square: faster than unique rows


METRICS = (
    Metric("failure_free", "failure-free", "", lambda episode, _: not episode.failed, "rate"),
    Metric("success", "goal reached", "", lambda episode, _: episode.success, "rate", goals_only=True),
    Metric("touch_free", "touch-free", "", lambda episode, _: not episode.touched, "rate", in_tables=False),
    Metric("distance", "distance", "m", lambda episode, _: episode.distance),
    Metric("return", "return", "", lambda episode, _: episode.episode_return),
    Metric("length", "length", "steps", lambda episode, _: episode.length, higher_is_better=None),
    Metric("mean_speed", "speed", "m/s", lambda episode, _: episode.distance, "ratio", per=lambda _, time: time),
    # Circling visits few squares.
    Metric("median_squares", "visited", "squares of 1 m (median)", lambda episode, _: squares(episode.path), "median"),
)


def figures(episodes: Sequence[Episode], control_period: float) -> dict[str, Any]:
    """The figures of all metrics, by their keys."""
    return {key: figure for metric in METRICS for key, figure in metric.figures(episodes, control_period).items()}


def shown_metrics(goal_task: bool) -> list[Metric]:
    """The metrics that tables, charts and TensorBoard show, for tasks with or without a goal."""
    return [metric for metric in METRICS if metric.in_tables and (goal_task or not metric.goals_only)]
