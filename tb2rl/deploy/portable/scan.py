"""Laser scans, and the meaning of their readings in the conventions of different drivers.

- inf: nothing within `range_max` (REP 117). A reading of `range_max` or more, as of older drivers, means the same.
- -inf: too near to be measured (REP 117): an obstacle at `range_min`. A reading below `range_min` counts as it is.
- NaN: no measurement (REP 117); the readings beside it stand in for it.
- 0: no light came back, in many small lidars. A few zeros between readings are like NaN. Many are like inf, else open
  space would be full of obstacles; but between readings that are hardly above `range_min` they are too near, because
  that is how a wall close by looks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

NEIGHBOURS = math.radians(10)  # readings farther apart are no neighbours: what lies between them is not seen
_HARDLY = 2.0  # times `range_min`


@dataclass(frozen=True)
class Scan:
    """One scan, with the fields of ROS's sensor_msgs/LaserScan.

    Attributes:
        ranges: [m], shape (readings,).
        angle_min: Direction of the first reading in the scanner's frame [rad].
        angle_increment: From one reading to the next [rad]; negative: clockwise.
        range_min, range_max: The shortest and the longest range that the scanner measures [m].
    """

    ranges: np.ndarray
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


def is_full_circle(angles: np.ndarray) -> bool:
    """Whether the last of the ascending angles [rad] is a neighbour of the first one."""
    return bool(angles[0] + math.tau - angles[-1] <= NEIGHBOURS)


def measured_distances(ranges: np.ndarray, angles: np.ndarray, scan: Scan) -> np.ndarray:
    """The distances of the readings [m]; inf: nothing there, NaN: not measured.

    Args:
        ranges: Of the scan, right to left, shape (readings,).
        angles: Directions of these readings, ascending [rad], shape (readings,).
        scan: For its `range_min` and `range_max`.
    """
    distances = np.where(ranges >= scan.range_max, np.inf, ranges) if scan.range_max > 0.0 else ranges.copy()
    distances[np.isneginf(ranges)] = scan.range_min
    zeros = np.isfinite(ranges) & (ranges <= 0.0)
    if zeros.any():
        distances[zeros] = np.nan
        distances[zeros] = _distances_of_zeros(np.flatnonzero(zeros), distances, angles, scan.range_min)
    return distances


def _distances_of_zeros(zeros: np.ndarray, distances: np.ndarray, angles: np.ndarray, range_min: float) -> np.ndarray:
    """NaN, inf or `range_min` for the zeros with these indices, by the valid readings on both sides of them."""
    valid = np.flatnonzero(~np.isnan(distances))
    if not valid.size:
        return np.full(zeros.size, np.nan)
    place = np.searchsorted(valid, zeros)
    right, left = valid[place - 1], valid[place % valid.size]
    gaps = np.mod(angles[left] - angles[right], math.tau)
    if not is_full_circle(angles):  # no neighbours beyond the ends
        first, last = place == 0, place == valid.size
        right[first], left[last] = left[first], right[last]
        gaps[first], gaps[last] = angles[left[first]] - angles[0], angles[-1] - angles[right[last]]
    many = (gaps > NEIGHBOURS) | (valid.size == 1)
    near = np.maximum(distances[right], distances[left]) < _HARDLY * range_min
    return np.where(near, range_min, np.where(many, np.inf, np.nan))
