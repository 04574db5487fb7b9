"""Learning curves: read from the files of a run folder, and put together over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import (
    SCALARS,
    EventAccumulator,
)
from tensorboard.compat.tensorflow_stub.errors import DataLossError, OutOfRangeError
from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import PyRecordReader_New

from tb2rl.core.errors import InputError, one_line
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.runs.journal import read_lines

POINTS = 120  # of a drawn curve, at most
_LOGGED = ("rollout/ep_rew_mean", "rollout/ep_len_mean", "rollout/failure_rate")
_NOTED = ("failure_free_rate", "success_rate")


@dataclass(frozen=True)
class Curve:
    """A figure of one training over its control steps."""

    steps: np.ndarray  # ascending, shape (points,)
    values: np.ndarray  # shape (points,)

    def thinned(self) -> Curve:
        """At most so many of its points as a chart shows, ends included."""
        if len(self.steps) <= POINTS:
            return self
        kept = np.linspace(0, len(self.steps) - 1, POINTS).round().astype(int)
        return Curve(self.steps[kept], self.values[kept])


@dataclass(frozen=True)
class Family:
    """The same figure of trainings that differ in nothing but their seed.

    Attributes:
        name: Of these trainings.
        colour: Theirs in every chart.
        curves: One a training, none of them empty.
    """

    name: str
    colour: str
    curves: Sequence[Curve]

    @cached_property
    def mean(self) -> Curve:
        """Their mean at the steps of any of them, as far as all of them go."""
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
    def cut(self) -> bool:
        """Whether some of them go on beyond the last step of `mean`."""
        return len({curve.steps[-1] for curve in self.curves}) > 1

    def _values(self, steps: np.ndarray) -> np.ndarray:
        return np.array([np.interp(steps, curve.steps, curve.values) for curve in self.curves])


def read_curves(folder: Path) -> dict[str, Curve]:
    """The curves of a run, by the tag in TensorBoard or the key in evaluations.jsonl; those that it has.

    Raises:
        InputError: If one of its files is damaged.
    """
    return {**read_events(folder / "tensorboard"), **read_evaluations(folder / "evaluations.jsonl")}


def read_events(folder: Path) -> dict[str, Curve]:
    """The curves in TensorBoard's event files, by tag; empty where there are no such files.

    Raises:
        InputError: If one is damaged.
    """
    if not folder.is_dir():
        return {}
    for file in sorted(folder.glob("*tfevents*")):
        _check_whole(file)
    events = EventAccumulator(str(folder), size_guidance={SCALARS: 0})  # 0: all of them
    events.Reload()
    curves = {}
    for tag in set(_LOGGED) & set(events.Tags()["scalars"]):
        scalars = events.Scalars(tag)
        curves[tag] = _curve([scalar.step for scalar in scalars], [scalar.value for scalar in scalars])
    return curves


def _check_whole(file: Path) -> None:
    """Refuse a file that TensorBoard would read the beginning of without a word.

    Only its end may be missing: that of a training which was killed, or is still writing.
    """
    reader = PyRecordReader_New(str(file))
    try:
        while True:
            reader.GetNext()
    except OutOfRangeError:
        return
    except DataLossError as error:
        if "truncated" not in str(error):
            raise InputError(f"{file} is damaged; remove it to go without its curves") from None


def read_evaluations(file: Path) -> dict[str, Curve]:
    """The curves of the evaluations while training, by figure; empty where there is no such file.

    Raises:
        InputError: If it is damaged.
    """
    if not file.is_file():
        return {}
    notes = read_lines(file)
    try:
        steps = [float(note["timesteps"]) for note in notes]
        curves = {key: _curve(steps, [float(note[key]) for note in notes]) for key in _NOTED}
        if not all(np.isfinite([*curve.steps, *curve.values]).all() for curve in curves.values()):
            raise ValueError("some of its numbers are not finite")
    except (LookupError, OverflowError, TypeError, ValueError) as error:
        raise InputError(one_line(f"{file} is damaged: {error or type(error).__name__}")) from None
    return curves if notes else {}


def _curve(steps: Sequence[float], values: Sequence[float]) -> Curve:
    order = np.argsort(steps, kind="stable")
    return Curve(np.array(steps, dtype=float)[order], np.array(values, dtype=float)[order])
