"""Intervals have the values of the tables, and comparisons those of the library rliable."""

import re

import numpy as np
import pytest

from tb2rl.evaluation.statistics import (
    Estimate,
    bootstrap_interval,
    improvement_probability,
    interquartile_mean,
    paired_difference,
    performance_profile,
    verdict,
    wilson_interval,
)

# Ten and eight trainings of five tasks; the figures below are what rliable 1.2.0 gives for them.
A = np.array(
    [
        [1.0, 2.18, 0.47, 0.35, 1.11], [0.7, 2.04, 0.63, 0.55, 1.08], [1.15, 2.21, 0.51, 0.33, 1.19],
        [1.21, 1.19, 0.45, -0.15, 0.94], [0.45, 1.86, 0.37, 0.94, 1.23], [0.94, 0.49, 0.45, 0.78, 1.22],
        [0.54, 1.71, 0.4, 0.4, 1.41], [0.76, 1.98, 0.59, 0.51, 1.18], [1.03, 2.04, 0.38, 0.84, 1.47],
        [0.54, 2.52, 0.51, 0.48, 1.6],
    ]
).T  # fmt: skip
B = np.array(
    [
        [1.13, 1.48, 0.51, 0.99, 0.96], [1.1, 2.16, 0.57, 1.42, 0.86], [0.96, 1.92, 0.51, 0.11, 0.88],
        [0.84, 2.74, 0.61, 0.04, 0.84], [1.09, 1.0, 0.45, 0.65, 1.25], [1.11, 2.0, 0.46, 0.57, 1.3],
        [0.77, 2.02, 0.54, 0.64, 0.96], [0.57, 2.19, 0.46, 1.28, 1.13],
    ]
).T  # fmt: skip


@pytest.mark.parametrize(
    ("count", "total", "interval"),
    [(95, 100, (0.8882, 0.9785)), (0, 10, (0.0, 0.2775)), (10, 10, (0.7225, 1.0)), (1, 2, (0.0945, 0.9055))],
)
def test_the_wilson_interval_has_the_values_of_the_tables(count, total, interval):
    assert wilson_interval(count, total) == pytest.approx(interval, abs=1e-4)


def paired(both: int, first: int, second: int, neither: int) -> tuple[np.ndarray, np.ndarray]:
    """Successes of as many trials under both conditions, the first or second one alone, or neither."""
    counts = both, first, second, neither
    return np.repeat([True, True, False, False], counts), np.repeat([True, False, True, False], counts)


@pytest.mark.parametrize(
    ("counts", "value", "low", "high"),
    [
        ((14, 5, 0, 22), -5 / 41, -0.2265, -0.0115),  # Altman et al. 2000, Statistics with confidence, table 6.2
        ((1, 1, 7, 12), 6 / 21, 0.0256, 0.5069),  # Bentur et al. 2009, by the R package contingencytables
        ((1000, 0, 0, 0), 0.0, -0.0038, 0.0038),  # that of Wilson's interval
    ],
)
def test_the_interval_of_a_paired_difference_is_that_of_newcombe(counts, value, low, high):
    found = paired_difference(*paired(*counts))
    assert (found.value, found.low, found.high) == pytest.approx((value, low, high), abs=1e-4)
    swapped = paired_difference(*reversed(paired(*counts)))
    assert (swapped.value, swapped.low, swapped.high) == pytest.approx((-value, -high, -low), abs=1e-4)


def test_pairs_make_the_interval_narrower_where_the_same_trials_fail():
    together, apart = paired_difference(*paired(900, 5, 5, 90)), paired_difference(*paired(815, 90, 90, 5))
    assert together.high < 0.5 * apart.high


def test_the_bootstrap_interval_is_that_of_the_mean_and_of_two_or_three_values_their_range():
    assert bootstrap_interval([1.0, 3.0]) == (1.0, 3.0)
    assert bootstrap_interval([4.0, 2.0, 3.0]) == pytest.approx((2.0, 4.0), abs=0.4)
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert bootstrap_interval(values) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)
    assert bootstrap_interval(values) == bootstrap_interval(values)


@pytest.mark.parametrize(
    ("made", "value", "low", "high"),
    [
        (Estimate.of(interquartile_mean, A), 0.85115385, 0.75692308, 0.94539423),
        (Estimate.of(interquartile_mean, B), 0.917, 0.821, 1.029),
        (Estimate.of(improvement_probability, A, B), 0.455, 0.34, 0.57128125),
    ],
)
def test_figures_and_intervals_are_those_of_rliable(made, value, low, high):
    assert made.value == pytest.approx(value, abs=1e-8)
    assert (made.low, made.high) == (pytest.approx(low, abs=0.01), pytest.approx(high, abs=0.01))


def test_profiles_are_those_of_rliable():
    shares, low, high = performance_profile(A, np.array([0.5, 1.0, 1.5]))
    np.testing.assert_allclose(shares, [0.74, 0.42, 0.18])
    np.testing.assert_allclose(low, [0.64, 0.34, 0.12], atol=0.021)
    np.testing.assert_allclose(high, [0.84, 0.5, 0.24], atol=0.021)


@pytest.mark.parametrize(
    ("ours", "theirs", "words"),
    [
        ([0.9], [0.5], "Too few seeds to tell: 1 seed where at least 5 are needed, and 10 are better."),
        ([0.9] * 4, [0.5] * 10, "Too few seeds to tell: 4 seeds where"),
        ([0.9, 0.5, 0.7, 0.8, 0.6], [0.9, 0.5, 0.7, 0.8, 0.6], "do not tell one and other apart"),
        ([0.9, 0.8, 0.85, 0.9, 0.95], [0.4, 0.3, 0.5, 0.2, 0.1], "one is better than other: .* too narrow"),
        ([0.1] * 10, [0.9] * 10, "other is better than one: the interval of the difference is on one side of 0.$"),
    ],
)
def test_what_is_said_in_words(ours, theirs, words):
    assert re.search(words, verdict([np.array(ours)], [np.array(theirs)], ("one", "other")))
