"""Fast marching: the same lengths as from a heap that takes the cells in ascending order."""

import heapq
import math
import runpy

import numpy as np
import pytest

from tb2rl.worlds import fast_marching
from tb2rl.worlds.fast_marching import march, march_to

CELL_SIDE = 0.05  # [m]


def costs_of_a_random_floor(seed):
    random = np.random.default_rng(seed)
    costs = np.where(random.random((40, 30)) < 0.3, random.uniform(1.0, 20.0, (40, 30)), 1.0)
    costs[random.random(costs.shape) < 0.15] = 0.0
    costs[:, 25] = 0.0  # the cells at its right are unreachable
    return costs


def lengths_by_heap(costs, goal):
    """Path lengths from all reachable cells, as in Sethian's paper; inf elsewhere."""
    steps = np.pad(CELL_SIDE * costs, 1)
    lengths, done = np.full(steps.shape, np.inf), steps == 0.0
    goal = goal[0] + 1, goal[1] + 1
    lengths[goal], queue, done[goal] = 0.0, [(0.0, goal)], False
    while queue:
        _, (i, j) = heapq.heappop(queue)
        if done[i, j]:
            continue
        done[i, j] = True
        for r, c in ((i, j + 1), (i + 1, j), (i, j - 1), (i - 1, j)):
            if done[r, c]:
                continue
            a, b = sorted((min(lengths[r, c - 1], lengths[r, c + 1]), min(lengths[r - 1, c], lengths[r + 1, c])))
            step = steps[r, c]
            length = 0.5 * (a + b + math.sqrt(2.0 * step**2 - (b - a) ** 2)) if b - a < step else a + step
            if length < lengths[r, c]:
                lengths[r, c] = length
                heapq.heappush(queue, (length, (r, c)))
    return lengths[1:-1, 1:-1].astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_lengths_are_those_of_a_heap_to_the_bit(seed):
    costs, goal = costs_of_a_random_floor(seed), (20, 10)
    lengths, expected = march(costs, *goal, CELL_SIDE), lengths_by_heap(costs, goal)
    reached = np.isfinite(expected)
    assert 500 < reached.sum() < 900
    np.testing.assert_array_equal(lengths[reached], expected[reached])
    assert np.isfinite(lengths).all()


def test_unreachable_cells_continue_the_nearest_lengths():
    lengths = march(np.array([[1.0, 1.0, 0.0, 1.0]]), 0, 0, CELL_SIDE)
    np.testing.assert_allclose(lengths, [[0.0, 0.05, 0.2, 0.35]])


def test_a_march_begins_in_a_blocked_cell_too():
    costs = np.ones((5, 5))
    costs[2, 2] = 0.0
    for lengths in (march(costs, 2, 2, CELL_SIDE), march_to(costs, 2, 2, CELL_SIDE, (0, 0))):
        assert lengths[2, 2] == 0.0
        assert lengths[2, 4] == pytest.approx(0.1)


def test_a_march_to_an_aim_ends_a_metre_behind_it():
    lengths, all_lengths = (march_to(np.ones((9, 200)), 4, 0, CELL_SIDE, (4, 50)), march(np.ones((9, 200)), 4, 0, 0.05))
    np.testing.assert_array_equal(lengths[4, :51], all_lengths[4, :51])
    assert np.isfinite(lengths[4, 55])
    assert np.isinf(lengths[:, 75:]).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (7, 9)])
def test_a_march_reads_only_its_arrays_on_a_floor_that_is_open_to_the_border(shape, monkeypatch):
    """Without the compiler, which does not check indices."""
    monkeypatch.setattr("tb2rl.core.compiled.njit", lambda **_: lambda function: function)
    functions = runpy.run_path(fast_marching.__file__)
    costs, corner = np.ones(shape), (shape[0] - 1, shape[1] - 1)
    for goal, aim in (((0, 0), corner), (corner, (0, 0))):
        with np.errstate(invalid="ignore"):  # inf - inf in blocked cells
            lengths, lengths_to_aim = (
                functions["march"](costs, *goal, CELL_SIDE),
                functions["march_to"](costs, *goal, CELL_SIDE, aim),
            )
        np.testing.assert_array_equal(lengths, lengths_by_heap(costs, goal))
        assert lengths_to_aim[aim] == pytest.approx(lengths[aim], rel=0.1)
