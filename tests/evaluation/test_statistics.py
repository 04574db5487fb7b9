"""Intervals have the values of the tables, and say how little a few trainings tell."""

from __future__ import annotations

import numpy as np
import pytest

from tb2rl.evaluation.statistics import bootstrap_interval, wilson_interval


@pytest.mark.parametrize(
    ("count", "total", "interval"),
    [(95, 100, (0.8882, 0.9785)), (0, 10, (0.0, 0.2775)), (10, 10, (0.7225, 1.0)), (1, 2, (0.0945, 0.9055))],
)
def test_the_wilson_interval_has_the_values_of_the_tables(count, total, interval):
    assert wilson_interval(count, total) == pytest.approx(interval, abs=1e-4)


def test_the_bootstrap_interval_of_two_or_three_values_is_their_range():
    assert bootstrap_interval([1.0, 3.0]) == (1.0, 3.0)
    assert bootstrap_interval([4.0, 2.0, 3.0]) == pytest.approx((2.0, 4.0), abs=0.4)
    assert bootstrap_interval([0.7]) == (0.7, 0.7)


def test_the_bootstrap_interval_of_many_values_is_that_of_their_mean():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert bootstrap_interval(values) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)
    assert bootstrap_interval(values) == bootstrap_interval(values)
