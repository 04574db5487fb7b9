"""Random numbers: from a generator of NumPy, and from counter-based streams."""

import numpy as np
import pytest

from tb2rl.simulation.random_streams import StreamSource, uniform


def draws_of(keys, counts):
    return StreamSource(np.array(keys, dtype=np.uint64), np.array(counts, dtype=np.uint64))


def test_an_environment_draws_the_next_numbers_of_its_own_stream_whatever_the_others_do():
    random = draws_of([5, 6], [0, 10])
    assert random.num_envs == 2
    numbers = np.hstack([random.uniform(3), random.uniform(2)])
    assert random.counts.tolist() == [5, 15]
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
