"""Learning curves: read from the files of a run folder, and averaged over seeds."""

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
from tb2rl.runs.journal import read_lines

POINTS = 120  # of a drawn curve, at most
_TAGS = ("rollout/ep_rew_mean", "rollout/ep_len_mean", "rollout/failure_rate")


@dataclass(frozen=True)
class Curve:
    """Values of one training by control step."""

    steps: np.ndarray  # ascending, shape (points,)
    values: np.ndarray  # shape (points,)

    def thinned(self) -> Curve:
        """At most `POINTS` of the points, ends included."""
        if len(self.steps) <= POINTS:
            return self
        kept = np.linspace(0, len(self.steps) - 1, POINTS).round().astype(int)
        return Curve(self.steps[kept], self.values[kept])


@dataclass(frozen=True)
class SeedCurves:
    """The curves of trainings that differ only in their seed; none is empty."""

    name: str
    colour: str
    curves: Sequence[Curve]

    @cached_property
    def mean(self) -> Curve:
        """The mean over the steps that all curves cover."""
        first = max(curve.steps[0] for curve in self.curves)
        last = min(curve.steps[-1] for curve in self.curves)
        steps = np.unique(np.concatenate([curve.steps for curve in self.curves]))
        steps = steps[(steps >= first) & (steps <= last)]
        return Curve(steps, self._values(steps).mean(axis=0)).thinned()

    @cached_property
    def interval(self) -> np.ndarray:
        """The 95 % bootstrap interval of each point of `mean`, shape (points, 2)."""
        columns = self._values(self.mean.steps).T
        return np.array([bootstrap_interval(column) for column in columns]).reshape(-1, 2)

    @property
    def is_cut(self) -> bool:
        """Whether some curves go beyond the last step of `mean`."""
        return len({curve.steps[-1] for curve in self.curves}) > 1

    def _values(self, steps: np.ndarray) -> np.ndarray:
        return np.array([np.interp(steps, curve.steps, curve.values) for curve in self.curves])


def read_curves(folder: Path) -> dict[str, Curve]:
    """The curves of a run folder, by the tag in TensorBoard or the key in evaluations.jsonl.

    Raises:
        InputError: If evaluations.jsonl is damaged.
    """
    return {**_read_events(folder / "tensorboard"), **_read_evaluations(folder / "evaluations.jsonl")}


def _read_events(folder: Path) -> dict[str, Curve]:
    if not folder.is_dir():
        return {}
    events = EventAccumulator(str(folder), size_guidance={SCALARS: 0})  # 0: all of them
    events.Reload()
    scalars = {tag: events.Scalars(tag) for tag in _TAGS if tag in events.Tags()["scalars"]}
    return {
        tag: _curve([each.step for each in found], [each.value for each in found]) for tag, found in scalars.items()
    }


def _read_evaluations(file: Path) -> dict[str, Curve]:
    lines = read_lines(file) if file.is_file() else []
    if not lines:
        return {}
    try:
        steps = [float(line["timesteps"]) for line in lines]
        rates = [metric.key for metric in shown_metrics(goal_task=True) if metric.kind == "rate"]
        curves = {key: _curve(steps, [float(line[key]) for line in lines]) for key in rates}
        if not all(np.isfinite([curve.steps, curve.values]).all() for curve in curves.values()):
            raise ValueError("some of its numbers are not finite")
    except (LookupError, OverflowError, TypeError, ValueError) as error:
        raise InputError(one_line(f"{file} is damaged: {error or type(error).__name__}")) from None
    return curves


def _curve(steps: Sequence[float], values: Sequence[float]) -> Curve:
    order = np.argsort(steps, kind="stable")
    return Curve(np.array(steps, dtype=float)[order], np.array(values, dtype=float)[order])
