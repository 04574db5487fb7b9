"""Random numbers: from a generator of NumPy, and from counter-based streams."""

import numpy as np
import pytest

from tb2rl.simulation.random_streams import GeneratorDraws, StreamDraws, normal, uniform


def draws_of(keys, counts):
    return StreamDraws(np.array(keys, dtype=np.uint64), np.array(counts, dtype=np.uint64))


def test_all_environments_draw_from_one_generator():
    expected = np.random.default_rng(0).random((3, 4))
    np.testing.assert_array_equal(GeneratorDraws(np.random.default_rng(0), 3).uniform(4), expected)
    assert GeneratorDraws(np.random.default_rng(0)).uniform(2).shape == (1, 2)


def test_an_environment_draws_the_next_numbers_of_its_own_stream_whatever_the_others_do():
    draws = draws_of([5, 6], [0, 10])
    assert draws.num_envs == 2
    numbers = np.hstack([draws.uniform(3), draws.uniform(2)])
    assert draws.counts.tolist() == [5, 15]
    for i, (key, first) in enumerate([(5, 0), (6, 10)]):
        assert numbers[i].tolist() == [uniform(np.uint64(key), np.uint64(first + k)) for k in range(5)]
        np.testing.assert_array_equal(draws_of([key], [first]).uniform(5)[0], numbers[i])


def test_streams_are_uniform_and_independent():
    numbers = draws_of(range(2000), [0] * 2000).uniform(50)
    assert numbers.min() >= 0.0
    assert numbers.max() < 1.0
    shares, _ = np.histogram(numbers, bins=10, range=(0, 1))
    assert shares / numbers.size == pytest.approx(0.1, abs=0.005)
    assert len(np.unique(numbers)) == numbers.size
    assert abs(np.corrcoef(numbers[:-1].ravel(), numbers[1:].ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(numbers[:, :-1].ravel(), numbers[:, 1:].ravel())[0, 1]) < 0.02


def test_normal_numbers_have_the_standard_normal_distribution():
    numbers = np.array([normal(np.uint64(7), np.uint64(count)) for count in range(20_000)])
    assert numbers.mean() == pytest.approx(0, abs=0.03)
    assert numbers.std() == pytest.approx(1, abs=0.02)
    assert (np.abs(numbers) < 1).mean() == pytest.approx(0.683, abs=0.015)
