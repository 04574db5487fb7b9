"""The laser's noise and its share of dropped beams."""

import numpy as np

from tb2rl.calibration.estimates import UNKNOWN, Estimate
from tb2rl.deploy.bags.reading import Drive
from tb2rl.deploy.bags.scans import Scans

_STILL = np.array([0.005, 0.01])  # [m/s], [rad/s] largest speeds of a robot that stands
_MIN_STILL_SCANS, _MIN_READINGS = 10, 300
_MODEL_ERRORS = {"still": 0.003, "moving": 0.06}  # relative standard errors by outliers and bent walls
_SAME_SURFACE = 0.2  # [m/m] relative difference of the neighbours of a dropped beam


def used_beams(scans: Scans) -> tuple[np.ndarray, np.ndarray]:
    """The beams that are measured at all: ranges (scans, used) and angles (used,)."""
    used = np.isfinite(scans.ranges).any(axis=0)
    return scans.ranges[:, used].astype(float), scans.angles[used]


def still_scans(drive: Drive, scans: Scans) -> np.ndarray:
    """Whether the robot stands in each scan and 0.3 s before, shape (scans,)."""
    times = drive.odometry[:, 0] - drive.odometry[:, 6]
    moving = times[(np.abs(drive.odometry[:, 4:6]) > _STILL).any(axis=1)]
    if not len(moving):
        return np.ones(len(scans.times), dtype=bool)
    index = np.searchsorted(moving, scans.times + 0.05)
    last = np.where(index > 0, moving[np.maximum(index - 1, 0)], -np.inf)
    return scans.times - last > 0.3


def noise(drive: Drive, scans: Scans, bias: float) -> Estimate:
    """Standard deviation of the ranges [m]: from scans at rest, or else from straight walls."""
    ranges, angles = used_beams(scans)
    still = still_scans(drive, scans)
    pairs = still[1:] & still[:-1]
    if pairs.sum() >= _MIN_STILL_SCANS:
        ranges = np.where(np.isfinite(ranges), ranges, np.nan)
        differences, kind = (np.diff(ranges, axis=0)[pairs] / np.sqrt(2.0)).ravel(), "still"
    else:
        differences, kind = _line_errors(ranges - bias, angles), "moving"
    differences = differences[np.isfinite(differences)]
    if len(differences) < _MIN_READINGS:
        return UNKNOWN
    spread = _spread(differences)
    error = spread * np.hypot(_MODEL_ERRORS[kind], 2.0 / np.sqrt(len(differences)))
    return Estimate.of(spread, error).within(0.0, np.inf)


def _line_errors(ranges: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Deviations of readings from straight lines through both neighbours, in units of the noise's standard deviation.

    On a straight wall 1/r is a sinusoid of the angle, so that u[-1] + u[1] = 2 cos(step) u[0].
    """
    steps, ranges = np.diff(angles), np.where(np.isfinite(ranges), ranges, np.nan)
    even = np.abs(np.diff(steps)) < 0.01 * steps[:-1]
    u, factor = 1.0 / ranges, 2.0 * np.cos(steps[:-1])
    errors = u[:, :-2] + u[:, 2:] - factor * u[:, 1:-1]
    weights = np.sqrt(u[:, :-2] ** 4 + u[:, 2:] ** 4 + factor**2 * u[:, 1:-1] ** 4)
    return errors[:, even].ravel() / np.maximum(weights[:, even].ravel(), 1e-9)


def _spread(values: np.ndarray) -> float:
    """Standard deviation of a normal distribution with outliers: that of the values within 3 deviations, corrected."""
    spread = 1.4826 * float(np.median(np.abs(values)))
    for _ in range(10):
        inside = values[np.abs(values) <= 2.0 * spread]
        spread = float(np.sqrt(np.mean(inside**2) / 0.7737)) if len(inside) else spread  # variance within 2 deviations
    return spread


def dropped(scans: Scans) -> Estimate:
    """Share of beams without a reading whose neighbours both see the same surface."""
    ranges, _ = used_beams(scans)
    left, right = ranges[:, :-2], ranges[:, 2:]
    with np.errstate(invalid="ignore"):
        same = np.isfinite(left) & np.isfinite(right) & (np.abs(left - right) < _SAME_SURFACE * np.minimum(left, right))
    lost = np.isinf(ranges[:, 1:-1]) & same
    count = int(same.sum())
    if count < _MIN_READINGS:
        return UNKNOWN
    share = float(lost.sum() / count)
    return Estimate.of(share, float(np.hypot(0.0001, np.sqrt((share + 1.0 / count) / count)))).within(0.0, 1.0)
