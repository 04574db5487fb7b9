"""What the readings of a scanner mean, whatever convention its driver follows.

- inf: nothing within `range_max` (REP 117), and so is what reaches `range_max`, as older drivers say it.
- -inf: too near to be measured (REP 117): an obstacle at `range_min`. A reading below `range_min` counts as it is.
- NaN: no measurement (REP 117); the readings beside it stand in for it.
- 0: many small lidars say so where no light came back. A few zeros between readings are like NaN. Many are like inf,
  else open space would be full of obstacles; but between readings that are hardly above `range_min` they are too near,
  for so it looks close to a wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

NEIGHBOURS = math.radians(10)  # readings that are farther apart are not neighbours: what lies between is not seen
_HARDLY = 2.0  # times `range_min`


@dataclass(frozen=True)
class Scan:
    """One turn of a scanner, in the words of ROS's sensor_msgs/LaserScan.

    Attributes:
        ranges: [m], shape (readings,).
        angle_min: Direction of the first reading in the scanner's frame [rad].
        angle_increment: From one reading to the next [rad]; negative: clockwise.
        range_min, range_max: The shortest and the longest range that it can measure [m].
    """

    ranges: np.ndarray
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


def goes_around(angles: np.ndarray) -> bool:
    """Whether the last of the ascending angles [rad] is a neighbour of the first, all around."""
    return bool(angles[0] + math.tau - angles[-1] <= NEIGHBOURS)


def distances_of(ranges: np.ndarray, angles: np.ndarray, scan: Scan) -> np.ndarray:
    """How far readings are [m]; inf: nothing is there, NaN: not measured.

    Args:
        ranges: Of the scan, right to left, shape (readings,).
        angles: To where they look, ascending [rad], shape (readings,).
        scan: Its limits.
    """
    distances = np.where(ranges >= scan.range_max, np.inf, ranges) if scan.range_max > 0.0 else ranges.copy()
    distances[np.isneginf(ranges)] = scan.range_min
    zeros = np.isfinite(ranges) & (ranges <= 0.0)
    if zeros.any():
        distances[zeros] = np.nan
        distances[zeros] = _zeros(np.flatnonzero(zeros), distances, angles, scan.range_min)
    return distances


def _zeros(zeros: np.ndarray, distances: np.ndarray, angles: np.ndarray, range_min: float) -> np.ndarray:
    """What the zeros with these numbers mean: NaN, inf or `range_min`, by what was measured on both sides of them."""
    valid = np.flatnonzero(~np.isnan(distances))
    if not valid.size:
        return np.full(zeros.size, np.nan)
    place = np.searchsorted(valid, zeros)
    right, left = valid[place - 1], valid[place % valid.size]
    gaps = np.mod(angles[left] - angles[right], math.tau)
    if not goes_around(angles):  # beyond the ends there is nothing
        first, last = place == 0, place == valid.size
        right[first], left[last] = left[first], right[last]
        gaps[first], gaps[last] = angles[left[first]] - angles[0], angles[-1] - angles[right[last]]
    many = (gaps > NEIGHBOURS) | (valid.size == 1)
    near = np.maximum(distances[right], distances[left]) < _HARDLY * range_min
    return np.where(near, range_min, np.where(many, np.inf, np.nan))
