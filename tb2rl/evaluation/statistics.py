"""Confidence intervals of rates and means, and comparisons of two sets of trainings (Agarwal et al. 2021, NeurIPS).

The project's tests compare the results with those of the library rliable. It is not a dependency, because it brings
300 MB, fails with the newest pandas and arch, and draws its intervals from NumPy's global state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

# An array for each task: the score of each training, shape (trainings,); with resampling (samples, trainings).
Scores = Sequence[np.ndarray]
# Seeds for each task: with fewer than `MIN_SEEDS` intervals are meaningless, with fewer than `GOOD_SEEDS` too narrow.
MIN_SEEDS, GOOD_SEEDS = 5, 10
_Z = 1.959964  # 97.5th percentile of the standard normal distribution
_PERCENTILES = (2.5, 97.5)  # ends of a 95 % interval
_SET_RESAMPLES, _MEAN_RESAMPLES = 5000, 10_000  # bootstrap samples for statistics of sets, and for a mean


def wilson_interval(count: int, total: int) -> tuple[float, float]:
    """The 95 % interval of a rate (Wilson 1927), which is valid near 0 and 1, too.

    Args:
        count: Number of successes.
        total: Number of trials, at least 1.
    """
    rate, z2_n = count / total, _Z * _Z / total
    centre = (rate + z2_n / 2) / (1 + z2_n)
    half_width = _Z / (1 + z2_n) * math.sqrt(rate * (1 - rate) / total + z2_n / (4 * total))
    return max(0.0, centre - half_width), min(1.0, centre + half_width)


def paired_difference(first: np.ndarray, second: np.ndarray) -> Estimate:
    """The rate of `second` minus that of `first`, with a 95 % interval for paired trials.

    The interval is method 10 of Newcombe 1998 (Improved confidence intervals for the difference between binomial
    proportions based on paired data, Statistics in Medicine 17): Wilson intervals of both rates, combined by their
    correlation. It is valid for rates near 0 and 1, too, where a bootstrap gives an interval without width.

    Args:
        first: Successes, bool, shape (trials,), with at least one trial.
        second: Successes under the other condition in the same trials, bool, shape (trials,).
    """
    total, count_1, count_2 = len(first), int(first.sum()), int(second.sum())
    rate_1, rate_2 = count_1 / total, count_2 / total
    (low_1, high_1), (low_2, high_2) = (wilson_interval(count, total) for count in (count_1, count_2))
    both, neither, only_1, only_2 = (
        int(np.sum((first == in_1) & (second == in_2))) for in_1, in_2 in ((1, 1), (0, 0), (1, 0), (0, 1))
    )
    association = float(both * neither - only_1 * only_2)
    if association > 0:
        association = max(association - total / 2, 0.0)  # continuity correction
    margins = count_1 * (total - count_1) * count_2 * (total - count_2)
    correlation = association / math.sqrt(margins) if margins else 0.0

    def combined(half_width_2: float, half_width_1: float) -> float:
        product = correlation * half_width_2 * half_width_1
        return math.sqrt(max(0.0, half_width_2**2 - 2 * product + half_width_1**2))

    difference = rate_2 - rate_1
    low = difference - combined(rate_2 - low_2, high_1 - rate_1)
    return Estimate(difference, low, difference + combined(high_2 - rate_2, rate_1 - low_1))


def bootstrap_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """The 95 % interval of the mean of a few trainings (percentile bootstrap); `values` has shape (trainings,).

    The interval is too narrow for fewer than ten values; for two or three values it is their range.
    """
    samples = np.random.default_rng(0).choice(np.asarray(values), size=(_MEAN_RESAMPLES, len(values)))
    low, high = np.percentile(samples.mean(axis=1), _PERCENTILES)
    return float(low), float(high)


@dataclass(frozen=True)
class Estimate:
    """A statistic and its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, statistic: Callable[..., np.ndarray], *sets: Scores) -> Estimate:
        """The estimate of a statistic of one or two sets, with a bootstrap interval over trainings."""
        samples = [resample(scores, seed) for seed, scores in enumerate(sets)]
        return cls(float(statistic(*sets)), *np.percentile(statistic(*samples), _PERCENTILES).tolist())


def interquartile_mean(scores: Scores) -> np.ndarray:
    """The mean of the middle half of all scores, shape (); with resampling (samples,)."""
    pooled = np.sort(np.concatenate(scores, axis=-1), axis=-1)
    quarter = pooled.shape[-1] // 4
    return pooled[..., quarter : pooled.shape[-1] - quarter].mean(axis=-1)


def interquartile_difference(first: Scores, second: Scores) -> np.ndarray:
    """The interquartile mean of the first set minus that of the second."""
    return interquartile_mean(first) - interquartile_mean(second)


def improvement_probability(first: Scores, second: Scores) -> np.ndarray:
    """Probability that a training of the first set has a higher score than one of the second, averaged over tasks.

    Equal scores have the probability 0.5. Shapes are as for `interquartile_mean`.
    """
    signs = [np.sign(a[..., :, None] - b[..., None, :]) for a, b in zip(first, second, strict=True)]
    return np.mean([(sign.mean(axis=(-1, -2)) + 1) / 2 for sign in signs], axis=0)


def resample(scores: Scores, seed: int = 0) -> list[np.ndarray]:
    """Stratified bootstrap samples: trainings are drawn within each task, shape (_SET_RESAMPLES, trainings)."""
    rng = np.random.default_rng(seed)
    return [task[rng.integers(len(task), size=(_SET_RESAMPLES, len(task)))] for task in scores]


def performance_profile(scores: Scores, thresholds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The share of trainings above each threshold, and the ends of its 95 % interval, each of shape (thresholds,)."""
    pooled, samples = np.concatenate(scores), np.concatenate(resample(scores), axis=1)
    shares = np.array([(samples > threshold).mean(axis=1) for threshold in thresholds])
    low, high = np.percentile(shares, _PERCENTILES, axis=1)
    return (pooled > thresholds[:, None]).mean(axis=1), low, high


def verdict(first: Scores, second: Scores, names: tuple[str, str]) -> str:
    """A sentence on which of two sets is better; `names` are the names of the sets."""
    num_seeds = min(len(task) for task in (*first, *second))
    if num_seeds < MIN_SEEDS:
        seeds = "1 seed" if num_seeds == 1 else f"{num_seeds} seeds"
        return f"Too few seeds to tell: {seeds} where at least {MIN_SEEDS} are needed, and {GOOD_SEEDS} are better."
    difference = Estimate.of(interquartile_difference, first, second)
    hint = f" With fewer than {GOOD_SEEDS} seeds the intervals are too narrow." if num_seeds < GOOD_SEEDS else ""
    if difference.low <= 0 <= difference.high:
        return f"These seeds do not tell {' and '.join(names)} apart: the interval of the difference contains 0.{hint}"
    better, worse = names if difference.value > 0 else names[::-1]
    return f"{better} is better than {worse}: the interval of the difference is on one side of 0.{hint}"
