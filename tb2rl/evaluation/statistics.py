"""Confidence intervals of rates and means."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

_Z = 1.959964  # 97.5th percentile of the standard normal distribution
_RESAMPLES = 10_000


def wilson_interval(count: int, total: int) -> tuple[float, float]:
    """The 95 % interval of a rate (Wilson 1927), which is valid near 0 and 1, too.

    Args:
        count: Number of successes.
        total: Number of trials, at least 1.

    Returns:
        The lower and the upper end, both in [0, 1].
    """
    rate, spread = count / total, _Z * _Z / total
    centre = (rate + spread / 2) / (1 + spread)
    half = _Z / (1 + spread) * math.sqrt(rate * (1 - rate) / total + spread / (4 * total))
    return max(0.0, centre - half), min(1.0, centre + half)


def bootstrap_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """The 95 % interval of the mean of a few trainings (percentile bootstrap, Agarwal et al. 2021).

    It is too narrow for fewer than ten values; for two or three it is their range.

    Args:
        values: One for each training, shape (trainings,).

    Returns:
        The lower and the upper end, in the unit of the values.
    """
    drawn = np.random.default_rng(0).choice(np.asarray(values), size=(_RESAMPLES, len(values)))
    low, high = np.percentile(drawn.mean(axis=1), [2.5, 97.5])
    return float(low), float(high)
