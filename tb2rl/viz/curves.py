"""Learning curves of run folders, and their mean over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import SCALARS, EventAccumulator

from tb2rl.core.errors import InputError, one_line
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs import EVALUATIONS, read_lines

MAX_POINTS = 120  # maximum number of points of a drawn curve
TRAINING_CURVES = {  # by TensorBoard tag: title, label of the y axis, whether the values are rates
    "rollout/ep_rew_mean": ("Return in training", "return of an episode", False),
    "rollout/ep_len_mean": ("Length in training", "steps of an episode", False),
    "rollout/failure_rate": ("Failures in training", "failed episodes", True),
}


@dataclass(frozen=True)
class Curve:
    """A quantity of one training over control steps."""

    steps: np.ndarray  # [control steps], ascending, shape (points,)
    values: np.ndarray  # shape (points,)

    def downsample(self) -> Curve:
        """At most `MAX_POINTS` of the points, including the first and the last one."""
        selected = np.linspace(0, len(self.steps) - 1, min(MAX_POINTS, len(self.steps))).round().astype(int)
        return Curve(self.steps[selected], self.values[selected])


@dataclass(frozen=True)
class SeedCurves:
    """Curves of trainings that differ only in their seed; each has at least one point."""

    name: str
    colour: str
    curves: Sequence[Curve]

    @cached_property
    def mean(self) -> Curve:
        """The mean curve over the steps that all curves cover."""
        first = max(curve.steps[0] for curve in self.curves)
        last = min(curve.steps[-1] for curve in self.curves)
        steps = np.unique(np.concatenate([curve.steps for curve in self.curves]))
        steps = steps[(steps >= first) & (steps <= last)]
        return Curve(steps, self._interpolate(steps).mean(axis=0)).downsample()

    @cached_property
    def interval(self) -> np.ndarray:
        """The 95 % bootstrap interval of each point of `mean`, shape (points, 2)."""
        values_by_step = self._interpolate(self.mean.steps).T
        return np.array([bootstrap_interval(values) for values in values_by_step]).reshape(-1, 2)

    @property
    def is_cut(self) -> bool:
        """Whether some curves continue after the last step of `mean`."""
        return len({curve.steps[-1] for curve in self.curves}) > 1

    def _interpolate(self, steps: np.ndarray) -> np.ndarray:
        """Values of all curves at some steps, shape (curves, len(steps))."""
        return np.array([np.interp(steps, curve.steps, curve.values) for curve in self.curves])


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
    file = folder / EVALUATIONS
    lines = read_lines(file) if file.is_file() else []
    keys = [metric.key for metric in shown_metrics(goal_task) if metric.statistic == "rate" and lines]
    try:
        points |= {key: [(line["timesteps"], line[key]) for line in lines] for key in keys}
        tables = {key: np.asarray_chkfinite(rows, dtype=float) for key, rows in points.items()}
        return {key: Curve(*rows[np.argsort(rows[:, 0], kind="stable")].T) for key, rows in tables.items()}
    except (LookupError, OverflowError, TypeError, ValueError) as error:
        raise InputError(one_line(f"{file} is damaged: {error!r}")) from None
