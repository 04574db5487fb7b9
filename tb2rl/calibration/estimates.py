"""Estimates with intervals, from nonlinear least squares."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A value with the ends of its 95 % interval; the interval is infinite if the drive does not show the value."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, error: float, quantile: float = 1.96) -> Estimate:
        """The estimate of a value with a standard error."""
        return cls(value, value - quantile * error, value + quantile * error)

    @property
    def half_width(self) -> float:
        """Half of the interval."""
        return 0.5 * (self.high - self.low)

    def times(self, factor: Estimate, systematic: float = 0.0) -> Estimate:
        """The product of two estimates, with a relative standard error of its own."""
        value, parts = self.value * factor.value, [each.half_width / each.value for each in (self, factor)]
        return Estimate.of(value, abs(value) * math.hypot(*parts, 1.96 * systematic), 1.0)

    def over(self, divisor: Estimate, systematic: float = 0.0) -> Estimate:
        """The quotient of two estimates, with a relative standard error of its own."""
        return self.times(Estimate.of(1.0 / divisor.value, divisor.half_width / divisor.value**2, 1.0), systematic)

    def within(self, low: float, high: float) -> Estimate:
        """The estimate, with all of its numbers in a possible range."""
        return Estimate(*(min(max(number, low), high) for number in (self.value, self.low, self.high)))


UNKNOWN = Estimate(math.nan, -math.inf, math.inf)


@dataclass(frozen=True)
class Solution:
    """Parameters from `solve`, and their covariance."""

    values: np.ndarray  # shape (parameters,)
    covariance: np.ndarray  # shape (parameters, parameters)
    quantile: float  # of Student's t, for an interval of 95 %
    count: int = 1  # number of residuals

    def estimate(self, index: int, systematic: float = 0.0) -> Estimate:
        """The estimate of a parameter, with a standard error that the data cannot show."""
        error = math.hypot(math.sqrt(self.covariance[index, index]), systematic)
        return Estimate.of(float(self.values[index]), error, self.quantile)


def solve(
    residuals: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    prior: np.ndarray,
    clusters: np.ndarray,
    centre: np.ndarray | None = None,
    nuisances: int = 0,
) -> Solution:
    """Robust least squares with a weak prior, and the cluster-robust covariance (Liang and Zeger 1986).

    Args:
        residuals: Function of the parameters: residuals in units of their usual size, shape (n,).
        start: Parameters at which to start, shape (parameters,).
        prior: Standard deviation of the prior, with the mean `centre` (default: `start`), shape (parameters,).
        clusters: Number of the cluster of each residual, shape (n,); residuals of one cluster depend on each other.
        nuisances: Number of parameters that do not count as degrees of freedom, because the prior holds them.
    """
    centre = start if centre is None else centre

    def scaled(steps: np.ndarray) -> np.ndarray:
        return residuals(start + steps * prior)

    def with_prior(steps: np.ndarray) -> np.ndarray:
        errors = scaled(steps)
        huberized = np.sign(errors) * np.sqrt(2.0 * (np.sqrt(1.0 + errors**2) - 1.0))  # their squares: soft L1 loss
        return np.concatenate([huberized, steps + (start - centre) / prior])

    found = least_squares(with_prior, np.zeros(len(start)), diff_step=1e-4, method="lm", max_nfev=30 * (len(start) + 1))
    steps = found.x
    errors, changes = scaled(steps), 1e-3 * np.eye(len(steps))
    jacobian = np.array([(scaled(steps + change) - scaled(steps - change)) / 2e-3 for change in changes]).T
    weights = 1.0 / np.sqrt(1.0 + errors**2)  # of the soft L1 loss
    scores = np.zeros((int(clusters.max(initial=0)) + 1, len(start)))
    np.add.at(scores, clusters, (weights * errors)[:, None] * jacobian)
    count = int((np.bincount(clusters, minlength=1) > 0).sum())
    freedom = max(1.0, count - len(start) + nuisances)
    bread = np.linalg.inv((jacobian.T * weights) @ jacobian + np.eye(len(start)))
    meat = scores.T @ scores * count / freedom + np.eye(len(start))
    covariance = bread @ meat @ bread * np.outer(prior, prior)
    return Solution(start + steps * prior, covariance, float(student.ppf(0.5 + CONFIDENCE / 2, freedom)), len(errors))
