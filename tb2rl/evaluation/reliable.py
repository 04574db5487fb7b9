"""Comparison of two sets of trainings by the measures of Agarwal et al. 2021 (NeurIPS).

Scores are one array for each task, with a score for each training, shape (trainings,). The tests compare the
figures with the library rliable 1.2.0. It is not a dependency, because it brings 300 MB, does not work with the newest
pandas and arch, and draws its intervals from NumPy's global state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Scores = Sequence[np.ndarray]
RESAMPLES = 5000
FEW, ENOUGH = 5, 10  # trainings of each task; intervals of fewer mean nothing, respectively are too narrow
_CUT = 0.25  # of the scores, at each end
_ENDS = (2.5, 97.5)  # [%]


@dataclass(frozen=True)
class Estimate:
    """A figure and its 95 % interval over trainings."""

    value: float
    low: float
    high: float


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """The mean of the middle half of all scores; shape (..., scores) to (...)."""
    count = scores.shape[-1]
    cut = int(_CUT * count)
    return np.sort(scores, axis=-1)[..., cut : count - cut].mean(axis=-1)


def probability_above(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Probability that one of our scores is above one of theirs, 0.5 if equal; shapes (..., n), (..., m) to (...)."""
    difference = ours[..., :, None] - theirs[..., None, :]
    return (np.sign(difference).mean(axis=(-1, -2)) + 1) / 2


def resampled(scores: Scores, seed: int) -> list[np.ndarray]:
    """Stratified bootstrap: trainings resampled within each task; each of shape (RESAMPLES, trainings)."""
    draws = np.random.default_rng(seed)
    return [task[draws.integers(len(task), size=(RESAMPLES, len(task)))] for task in scores]


def middle(scores: Scores) -> Estimate:
    """The interquartile mean over the trainings of all tasks."""
    again = interquartile_mean(np.concatenate(resampled(scores, 0), axis=1))
    return _estimate(interquartile_mean(np.concatenate(list(scores))), again)


def difference(ours: Scores, theirs: Scores) -> Estimate:
    """Our interquartile mean minus theirs."""
    again = [interquartile_mean(np.concatenate(each, axis=1)) for each in (resampled(ours, 0), resampled(theirs, 1))]
    value = interquartile_mean(np.concatenate(list(ours))) - interquartile_mean(np.concatenate(list(theirs)))
    return _estimate(value, again[0] - again[1])


def improvement(ours: Scores, theirs: Scores) -> Estimate:
    """Probability that a training of ours is better than one of theirs at the same task, averaged over tasks."""
    value = np.mean([probability_above(*pair) for pair in zip(ours, theirs, strict=True)])
    pairs = zip(resampled(ours, 0), resampled(theirs, 1), strict=True)
    return _estimate(value, np.mean([probability_above(*pair) for pair in pairs], axis=0))


def profile(scores: Scores, thresholds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The share of trainings above each threshold, and the ends of its interval; each of shape (thresholds,)."""
    every, again = np.concatenate(list(scores)), np.concatenate(resampled(scores, 0), axis=1)
    shares = np.array([(again > threshold).mean(axis=1) for threshold in thresholds])
    low, high = np.percentile(shares, _ENDS, axis=1)
    return (every > thresholds[:, None]).mean(axis=1), low, high


def _estimate(value: np.ndarray | float | np.floating, again: np.ndarray) -> Estimate:
    low, high = np.percentile(again, _ENDS)
    return Estimate(float(value), float(low), float(high))


def verdict(ours: Scores, theirs: Scores, names: tuple[str, str]) -> str:
    """Which of two is better, in words, if these trainings can tell.

    Args:
        ours: The scores of the first.
        theirs: Those of the second, at the same tasks.
        names: Of the first and of the second.
    """
    fewest = min(len(task) for task in (*ours, *theirs))
    if fewest < FEW:
        seeds = "1 seed" if fewest == 1 else f"{fewest} seeds"
        return f"Too few seeds to tell: {seeds} where at least {FEW} are needed, and {ENOUGH} are better."
    by = difference(ours, theirs)
    narrow = f" With fewer than {ENOUGH} seeds the intervals are too narrow." if fewest < ENOUGH else ""
    if by.low <= 0 <= by.high:
        apart = f"These seeds do not tell {names[0]} and {names[1]} apart"
        return f"{apart}: the interval of the difference has 0 in it.{narrow}"
    better, worse = names if by.value > 0 else names[::-1]
    return f"{better} is better than {worse}: the interval of the difference is on one side of 0.{narrow}"
