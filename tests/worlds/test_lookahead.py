"""Lookahead points and path lengths of many environments are those of each environment alone."""

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, generate
from tb2rl.worlds.goal_paths import RANDOM_GOALS, GoalPaths, path_lengths_to
from tb2rl.worlds.lookahead import lookahead_points, path_lengths

WORLDS = generate(GeneratorSettings("rooms", worlds=3), GENERATORS["rooms"], "training")


@pytest.fixture(scope="module")
def paths():
    return GoalPaths(WORLDS, ROBOT.radius)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("lookahead", [0.01, 1.5, 30.0])  # less than a step, the default, and beyond most goals
def test_each_environment_has_the_paths_that_it_has_alone(lookahead, threads, paths, monkeypatch):
    monkeypatch.setattr("tb2rl.core.threads.MIN_PARALLEL_TIME", 0.0)
    monkeypatch.setattr("tb2rl.core.threads.THREADS", threads)
    rng, count = np.random.default_rng(0), 75
    worlds, goals = rng.integers(3, size=count), rng.integers(1, RANDOM_GOALS + 1, size=count)
    low, high = np.array([world.bounds for world in WORLDS])[worlds].reshape(-1, 2, 2).transpose(1, 0, 2)
    places = rng.uniform(low - 0.5, high + 0.5)  # some in walls and outside
    places[:20] = paths.goals(worlds[:20], goals[:20]) + rng.normal(0.0, 0.3, (20, 2))  # and some at the goal
    points, lengths = paths.lookahead_point(worlds, goals, places, lookahead), paths.path_length(worlds, goals, places)
    assert np.isfinite(points).all()
    for i in range(count):
        row = slice(i, i + 1)
        assert (paths.lookahead_point(worlds[row], goals[row], places[row], lookahead) == points[i]).all()
        assert paths.path_length(worlds[row], goals[row], places[row]) == lengths[i]


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 2), (3, 4)])
def test_paths_lead_to_the_goal_on_the_smallest_grids(shape):
    (rows, columns), cell_side = shape, 1.0
    grid = np.array([rows, columns, 0.0, 0.0, cell_side])
    goal, start = np.array([columns - 1.0, rows - 1.0]), np.zeros((1, 2))
    lengths = path_lengths_to(goal, np.ones(shape), grid).ravel()
    arguments = np.zeros(1, dtype=int), grid[None], lengths, start
    assert path_lengths(*arguments)[0] == pytest.approx(lengths[0])
    assert lookahead_points(*arguments, goal[None], 9.0)[0] == pytest.approx(goal, abs=1e-6)
