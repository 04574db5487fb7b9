"""Laser scans, and the meaning of their readings in the conventions of different drivers.

- inf: no obstacle within `range_max` (REP 117). Older drivers send `range_max` or more instead.
- -inf: an obstacle too near to be measured (REP 117); it is assumed at `range_min`. A finite reading below `range_min`
  is used unchanged.
- NaN: no measurement (REP 117); the readings beside it are used.
- 0: no reflection, in many small lidars. A narrow gap of zeros is treated like NaN, and a wide gap like inf, because
  open space would otherwise be full of obstacles. Zeros between two readings near `range_min` are treated like -inf,
  because a very near wall often causes zeros.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

MAX_GAP = math.radians(10)  # [rad] between neighbouring readings; the surface in a wider gap is unknown
_MAX_NEAR_RANGE = 2.0  # [multiples of range_min] zeros between readings up to this range mean a very near wall


@dataclass(frozen=True)
class Scan:
    """One scan, with the fields of ROS's sensor_msgs/LaserScan.

    Attributes:
        ranges: [m], shape (readings,).
        angle_min: Direction of the first reading in the scanner's frame [rad].
        angle_increment: Angle from one reading to the next [rad]; negative: clockwise.
        range_min, range_max: The shortest and the longest range that the scanner measures [m].
    """

    ranges: np.ndarray
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


def is_full_circle(angles: np.ndarray) -> bool:
    """Whether ascending angles [rad] leave no gap between the last and the first one."""
    return bool(angles[0] + math.tau - angles[-1] <= MAX_GAP)


def measured_distances(ranges: np.ndarray, angles: np.ndarray, scan: Scan) -> np.ndarray:
    """Convert readings to distances [m], which are inf without an obstacle, and NaN without a measurement.

    Args:
        ranges: Readings of the scan, right to left [m], shape (readings,).
        angles: Directions of the readings, ascending [rad], shape (readings,).
        scan: The scan, which defines `range_min` and `range_max`.
    """
    distances = np.where(ranges >= scan.range_max, np.inf, ranges) if scan.range_max > 0.0 else ranges.copy()
    distances[np.isneginf(ranges)] = scan.range_min
    zeros = np.flatnonzero(np.isfinite(ranges) & (ranges <= 0.0))
    distances[zeros] = np.nan
    valid = np.flatnonzero(~np.isnan(distances))
    if not zeros.size or not valid.size:
        return distances
    index = np.searchsorted(valid, zeros)  # the valid readings on both sides of a zero define its meaning
    right, left = valid[index - 1], valid[index % valid.size]
    gaps = np.mod(angles[left] - angles[right], math.tau)
    if not is_full_circle(angles):  # zeros at the ends have a valid reading on one side only
        no_right, no_left = index == 0, index == valid.size
        right[no_right], left[no_left] = left[no_right], right[no_left]
        gaps[no_right], gaps[no_left] = angles[left[no_right]] - angles[0], angles[-1] - angles[right[no_left]]
    is_wide = (gaps > MAX_GAP) | (valid.size == 1)
    is_near = np.maximum(distances[right], distances[left]) < _MAX_NEAR_RANGE * scan.range_min
    distances[zeros] = np.where(is_near, scan.range_min, np.where(is_wide, np.inf, np.nan))
    return distances
