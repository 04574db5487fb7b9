"""From a reading to what an agent observes: distance classes for tables, raw ranges for networks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium import spaces
from numba import njit

from tb2rl.errors import InputError, unknown
from tb2rl.maze import Maze, load_maze
from tb2rl.robot import Laser
from tb2rl.simulation import Reading
from tb2rl.tasks import Task


def ranges_to_bins(ranges: np.ndarray, edges: Sequence[float] | np.ndarray) -> np.ndarray:
    """Sort laser ranges into distance classes.

    Args:
        ranges: Distances to the nearest obstacle [m], shape (robots, beams), right to left; inf where nothing was hit.
        edges: Strictly increasing class borders [m], shape (bins - 1,).

    Returns:
        Class of each beam, shape (robots, beams), integers in [0, bins); 0 is nearest, and what NaN becomes.
    """
    bins = np.zeros(np.shape(ranges), dtype=np.int64)
    _count_edges(np.asarray(ranges, dtype=float).ravel(), np.asarray(edges, dtype=float), bins.reshape(-1))
    return bins


@njit(cache=True)
def _count_edges(ranges, edges, bins):
    for i in range(ranges.size):
        for edge in edges:
            bins[i] += ranges[i] >= edge


class DiscreteScan:
    """Distance classes of a few beams, and of the task's own senses: for tabular learners."""

    beams = 7  # 30 degrees apart

    def __init__(self, task: Task, laser: Laser) -> None:
        self.task = task
        self.edges = _increasing(task.edges, "task.edges")
        self.sense_edges = [_increasing(sense.edges, sense.name) for sense in task.senses]
        classes = [len(self.edges) + 1] * len(laser.angles) + [len(edges) + 1 for edges in self.sense_edges]
        self.space = spaces.MultiDiscrete(classes)

    def __call__(self, reading: Reading) -> np.ndarray:
        bins = ranges_to_bins(reading.ranges, self.edges)
        if not self.sense_edges:
            return bins
        values = self.task.sense(reading)
        senses = [ranges_to_bins(values[:, i], edges) for i, edges in enumerate(self.sense_edges)]
        return np.column_stack([bins, *senses])


class RawScan:
    """The ranges in metres (nothing hit: the longest one) and the task's own senses as they are: for networks."""

    beams = 36

    def __init__(self, task: Task, laser: Laser) -> None:
        self.task, self.laser = task, laser
        beams = len(laser.angles)
        low = [laser.min_range] * beams + [sense.low for sense in task.senses]
        high = [laser.max_range] * beams + [sense.high for sense in task.senses]
        self.space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)

    def __call__(self, reading: Reading) -> np.ndarray:
        values = reading.ranges
        if self.task.senses:
            values = np.maximum(np.column_stack([values, self.task.sense(reading)]), self.space.low)
        return np.minimum(values, self.space.high).astype(np.float32)


Observation = DiscreteScan | RawScan
OBSERVATIONS: dict[str, type[DiscreteScan] | type[RawScan]] = {"discrete": DiscreteScan, "raw": RawScan}


def observe_as(mode: str, task: Task) -> tuple[Observation, Laser]:
    """The observation of a mode, "discrete" or "raw", and the laser that it reads.

    Raises:
        InputError: For an unknown mode, kept beams that the laser lacks, or class borders that do not increase.
    """
    if mode not in OBSERVATIONS:
        raise unknown("observation", mode, OBSERVATIONS)
    laser = task.laser(OBSERVATIONS[mode].beams)
    if task.kept is not None and max(task.kept) >= laser.beams:
        raise InputError(
            f"task.kept names beam {max(task.kept)}, but the laser has {laser.beams} beams, counted from 0"
        )
    return OBSERVATIONS[mode](task, laser), laser


def prepare(task: Task, mode: str) -> tuple[Maze, Task, Observation, Laser]:
    """The maze of a task, the task placed in it, and how it is observed there; see `observe_as`."""
    maze = load_maze(task.maze)
    placed = task.placed(maze)
    return maze, placed, *observe_as(mode, placed)


def _increasing(edges: Sequence[float], name: str) -> np.ndarray:
    values = np.asarray(edges, dtype=float)
    if not (np.diff(values) > 0).all():
        raise InputError(f"{name} must strictly increase, got {list(edges)}")
    return values
