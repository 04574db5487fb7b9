"""Paths to goals: their lengths, their distance from walls, and the lookahead points along them."""

import math
import pickle

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds import World
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings, generate
from tb2rl.worlds.goal_paths import OWN_GOAL, RANDOM_GOALS, GoalPaths, shortest_path_length

BOUNDS = (0.0, 0.0, 8.0, 8.0)
OPEN = World.from_shapes("open", start=(1.0, 4.0, 0.0), goal=(7.0, 4.0, 0.0), bounds=BOUNDS)
# A wall from below up to y = 6 m between the start and the goal, and one from side to side.
WALL = World.from_shapes("wall", [(4, 3, 0.2, 6, 0)], start=(2.0, 2.0, 0.0), goal=(6.0, 2.0, 0.0), bounds=BOUNDS)
CLOSED = World.from_shapes("closed", [(4, 4, 0.2, 8, 0)], start=(2.0, 4.0, 0.0), goal=(6.0, 4.0, 0.0), bounds=BOUNDS)
MIXED = generate(GeneratorSettings("mixed", worlds=10), GENERATORS["mixed"], "training")


def to_own_goal(world, *places):
    worlds = np.zeros(len(places), dtype=int)
    return GoalPaths([world], ROBOT.radius), worlds, np.full(len(places), OWN_GOAL), np.array(places, dtype=float)


def test_a_path_is_straight_on_an_open_floor_and_goes_round_a_wall_and_keeps_off_it():
    places = [(1.0, 4.0), (4.0, 1.0), (7.0, 7.2), (6.95, 4.0), (2.0, 6.5)]
    paths, worlds, goals, there = to_own_goal(OPEN, *places)
    straight = [math.dist(place, (7.0, 4.0)) for place in places]
    assert paths.path_length(worlds, goals, there) == pytest.approx(straight, abs=0.2)
    paths, worlds, goals, there = to_own_goal(WALL, (2.0, 2.0))
    corner = math.dist((2.0, 2.0), (3.9, 6.0 + ROBOT.radius)) + 0.2 + math.dist((4.1, 6.0 + ROBOT.radius), (6.0, 2.0))
    assert 1.0 < shortest_path_length(WALL, ROBOT.radius) / corner < 1.05
    assert corner < paths.path_length(worlds, goals, there)[0] < corner + 1.5, "near a wall it counts as longer"
    above = paths.lookahead_point(worlds, goals, there, 4.9)[0]
    assert above[1] - 6.0 > ROBOT.radius + 0.05, "it passes the corner with room to spare"


def test_lookahead_points_lead_to_the_goal_and_no_farther():
    paths, worlds, goals, there = to_own_goal(WALL, WALL.start[:2])
    length, driven = paths.path_length(worlds, goals, there)[0], 0.0
    for _ in range(400):
        after = paths.lookahead_point(worlds, goals, there, 0.1)
        assert np.hypot(*(after - there).T)[0] <= 0.1 + 1e-9
        assert WALL.clearance(*after[0]) >= ROBOT.radius
        driven, there = driven + np.hypot(*(after - there).T)[0], after
    np.testing.assert_allclose(there[0], WALL.goal[:2], atol=1e-9)
    assert driven < length + 0.1


def test_a_path_from_beside_a_thin_wall_does_not_lead_through_it():
    """The goal is behind the wall, so that what is behind it is nearer by far."""
    places = [(3.9 - ROBOT.radius - gap, y) for gap in (0.0, 0.01, 0.03, 0.06) for y in np.arange(1.0, 4.5, 0.1)]
    paths, worlds, goals, there = to_own_goal(WALL, *places)
    for _ in range(60):
        there = paths.lookahead_point(worlds, goals, there, 0.05)
        assert min(WALL.clearance(x, y) for x, y in there) > 0.1


def test_random_goals_can_be_reached_and_do_not_depend_on_other_environments():
    paths, worlds = GoalPaths(MIXED, ROBOT.radius), np.repeat(np.arange(10), RANDOM_GOALS)
    numbers, starts = np.tile(np.arange(1, RANDOM_GOALS + 1), 10), np.array([MIXED[i].start[:2] for i in worlds])
    goals, lengths = paths.goals(worlds, numbers), paths.path_length(worlds, numbers, starts)
    assert min(MIXED[i].clearance(*goal) for i, goal in zip(worlds, goals, strict=True)) >= 0.3
    assert (lengths < 60).all()
    assert len({tuple(goal) for goal in goals.tolist()}) > 30, "random goals differ"
    for i in range(0, len(worlds), 19):
        alone, row = GoalPaths(MIXED, ROBOT.radius), slice(i, i + 1)
        assert (alone.goals(worlds[row], numbers[row]) == goals[i]).all()
        assert alone.path_length(worlds[row], numbers[row], starts[row]) == lengths[i]


def test_paths_depend_neither_on_the_count_of_threads_nor_on_other_goals(monkeypatch):
    worlds, numbers = np.repeat(np.arange(10), RANDOM_GOALS + 1), np.tile(np.arange(RANDOM_GOALS + 1), 10)
    starts = np.array([MIXED[i].start[:2] for i in worlds])
    lengths, goals = [], []
    for threads, order in ((1, np.arange(50)), (4, np.arange(50)), (4, np.arange(50)[::-1])):
        monkeypatch.setattr("tb2rl.worlds.goal_paths.THREADS", threads)
        paths = GoalPaths(MIXED, ROBOT.radius)
        for some in np.split(order, [1, 17, 18]):
            paths.path_length(worlds[some], numbers[some], starts[some])
        lengths.append(paths.path_length(worlds, numbers, starts))
        goals.append(paths.goals(worlds, numbers))
    assert (lengths[0] == lengths[1:]).all()
    np.testing.assert_array_equal(goals[0], goals[1])
    np.testing.assert_array_equal(goals[0], goals[2])


def test_goals_that_are_needed_one_by_one_are_computed_in_few_batches_of_their_kind(monkeypatch):
    monkeypatch.setattr("tb2rl.worlds.goal_paths.THREADS", 2)
    batches, compute = [], GoalPaths._compute_paths
    monkeypatch.setattr(GoalPaths, "_compute_paths", lambda self, goals: batches.append(goals) or compute(self, goals))
    paths = GoalPaths(MIXED, ROBOT.radius)
    for i in np.random.default_rng(0).permutation(10 * RANDOM_GOALS):
        paths.goals(np.array([i // RANDOM_GOALS]), np.array([1 + i % RANDOM_GOALS]))
    assert [len(batch) for batch in batches] == [1, 1, 2, 4, 8, 16, 8]
    for world in range(10):
        paths.goals(np.array([world]), np.array([OWN_GOAL]))
    assert [len(batch) for batch in batches[7:]] == [10], "own goals are not computed before one is needed"
    monkeypatch.setattr("tb2rl.worlds.goal_paths.THREADS", 1)
    paths = GoalPaths(MIXED, ROBOT.radius)
    for world in range(10):
        paths.goals(np.array([world]), np.array([1]))
    assert [len(batch) for batch in batches[8:]] == [1] * 10, "one thread gains nothing by batches"


def test_an_error_in_a_thread_is_raised_and_other_worlds_have_paths():
    too_large = World.from_shapes("large", start=(1.0, 1.0, 0.0), goal=(2.0, 1.0, 0.0), bounds=(0.0, 0.0, 1e4, 1e4))
    paths, goals = GoalPaths([OPEN, too_large, WALL], ROBOT.radius), np.full(3, OWN_GOAL)
    with pytest.raises(InputError, match="world large"):
        paths.goals(np.arange(3), goals)
    np.testing.assert_array_equal(paths.goals(np.array([0, 2]), goals[:2]), [OPEN.goal[:2], WALL.goal[:2]])


def test_only_path_lengths_are_kept():
    paths, places = GoalPaths(MIXED, ROBOT.radius), np.zeros((10, 2))
    paths.path_length(np.arange(10), np.ones(10, dtype=int), places)
    cells = 10 * round(8.0 / 0.05) ** 2
    assert len(pickle.dumps(paths)) < 8 * cells, "the costs of the cells alone would take as much"


def test_lengths_are_finite_without_a_path_and_random_goals_without_an_own_one():
    assert shortest_path_length(CLOSED, ROBOT.radius) == math.inf
    paths, worlds, goals, there = to_own_goal(CLOSED, (2.0, 4.0))
    assert np.isfinite(paths.path_length(worlds, goals, there)).all()
    assert np.isfinite(paths.lookahead_point(worlds, goals, there, 1.0)).all()
    lacking = World.from_shapes("lacking", start=(1.0, 1.0, 0.0), bounds=BOUNDS)
    paths, worlds, goals, _ = to_own_goal(lacking, (1.0, 1.0))
    assert np.isnan(paths.goals(worlds, goals)).all()
    assert np.isfinite(paths.goals(worlds, goals + 1)).all()


def test_a_path_never_ends_before_its_goal():
    """Between costly cells, the slope may oscillate across the path."""
    worlds = generate(GeneratorSettings("rooms", worlds=10), GENERATORS["rooms"], "training")
    paths, each = GoalPaths(worlds, ROBOT.radius), np.repeat(np.arange(10), 100)
    places = np.random.default_rng(0).uniform(0.3, 7.7, (len(each), 2))
    free = np.array([worlds[i].clearance(*place) > 0.2 for i, place in zip(each, places, strict=True)])
    each, places, numbers = each[free], places[free], np.full(free.sum(), OWN_GOAL)
    before = paths.path_length(each, numbers, places)
    after = paths.path_length(each, numbers, paths.lookahead_point(each, numbers, places, 1.0))
    assert (before - after > 0.9)[before > 1.5].all(), "a metre along the path is a metre less, at least"
