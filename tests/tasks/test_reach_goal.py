"""TurtleBot2Wall: the rules of the tutorial, and where the goal comes from."""

import numpy as np
import pytest

from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.worlds.description import world_from

TUTORIAL = {"goal": (5.0, 0.0), "bounds": (-1.0, -3.0, 6.0, 3.0)}
TASK = ReachGoal(goal_tolerance=0.05)


def draws(num_envs=1):
    return GeneratorDraws(np.random.default_rng(0), num_envs)


@pytest.mark.parametrize(
    ("before", "after", "reward", "ending", "success"),
    [
        ((0, 0), (0.1, 0), 5 + 5, None, False),  # closer
        ((0.1, 0), (0, 0), 5, None, False),  # farther
        ((0, 0), (0, 0), 5, None, False),  # as far as before
        ((4.9, 0), (4.96, 0.04), 200, "goal", True),
        ((4.9, 0), (5.04, -0.04), 200, "goal", True),
        ((4.9, 0), (4.96, 0.06), 5 + 5, None, False),  # near enough in x only
        ((4.9, 0), (4.94, 0.0), 5 + 5, None, False),  # near enough in y only
        ((5.9, 0), (6.01, 0), -200, "out of bounds", False),
        ((-0.9, 0), (-1.01, 0), -200, "out of bounds", False),
        ((0, 2.9), (0, 3.01), -200, "out of bounds", False),
        ((0, -2.9), (0, -3.01), -200, "out of bounds", False),
        ((5.9, 2.9), (6.0, 3.0), 5, None, False),  # (-1, 6] and (-3, 3]: the upper bounds belong to it,
        ((-0.9, 0), (-1.0, 0), -200, "out of bounds", False),  # the lower ones do not
        ((0, -2.9), (0, -3.0), -200, "out of bounds", False),
    ],
)
def test_reach_goal_follows_the_rules_of_the_tutorial(before, after, reward, ending, success, make_reading):
    begun, ended = make_reading(pose=(*before, 0), **TUTORIAL), make_reading(pose=(*after, 0), **TUTORIAL)
    outcome = TASK.outcome(begun, np.array([0]), ended)
    assert outcome.reward == [reward]
    endings = {**outcome.failed, **outcome.succeeded}
    assert [reason for reason, where in endings.items() if where[0]] == ([ending] if ending else [])
    assert outcome.terminated == [ending is not None]
    assert outcome.succeeded["goal"] == [success]
    said = outcome.ending(0, timed_out=False)
    assert (said and (said.name, said.success, said.failed)) == (ending and (ending, success, not success))


def test_a_turn_that_comes_closer_is_paid_as_a_turn_and_as_closer(make_reading):
    before, after = make_reading(pose=(0, 0, 0), **TUTORIAL), make_reading(pose=(0.1, 0, 0), **TUTORIAL)
    assert TASK.outcome(before, np.array([TASK.actions.left]), after).reward == [1 + 5]


def test_a_crash_at_the_goal_is_a_crash(make_reading):
    after = make_reading([0.4, 3.0], bumped=[False, True], pose=(5, 0, 0), **TUTORIAL)
    outcome = TASK.outcome(after, np.array([0, 0]), after)
    assert outcome.reward.tolist() == [-200, -200]
    for robot in (0, 1):
        ending = outcome.ending(robot, timed_out=False)
        assert (ending.name, ending.success, ending.failed) == ("collision", False, True)


def test_every_robot_has_its_own_goal_and_bounds(make_reading):
    poses = [(1, 1, 0), (1, 1, 0), (1, 1, 0)]
    goals, bounds = [(1, 1), (5, 5), (5, 5)], [(0, 0, 9, 9), (0, 0, 9, 9), (2, 2, 9, 9)]
    after = make_reading(pose=poses, goal=goals, bounds=bounds)
    outcome = TASK.outcome(after, np.zeros(3, int), after)
    assert [outcome.ending(robot, False) and outcome.ending(robot, False).name for robot in range(3)] == [
        "goal",
        None,
        "out of bounds",
    ]


def test_reach_goal_takes_goal_and_bounds_from_its_world_unless_it_is_told(make_setup):
    spec = make_setup("wall")
    start = ReachGoal().initial_state(spec, draws(2))
    assert start.goal.tolist() == [[5.0, 0.0]] * 2
    assert start.bounds.tolist() == [[-1.0, -3.0, 6.0, 3.0]] * 2
    told = ReachGoal(goal=(1.0, 2.0), bounds=(0.0, 0.0, 3.0, 3.0)).initial_state(spec, draws(2))
    assert told.goal.tolist() == [[1.0, 2.0]] * 2
    assert told.bounds.tolist() == [[0.0, 0.0, 3.0, 3.0]] * 2


def test_reach_goal_takes_its_own_goal_to_a_world_without_one(make_setup):
    assert ReachGoal(goal=(1, 2)).initial_state(make_setup("loop"), draws()).goal.tolist() == [[1, 2]]


def test_the_pose_of_a_goal_in_a_file_is_where_to_get(make_setup):
    content = {"start": [0, 0, 0], "goal": [3, 1, 1.5], "bounds": [-5, -5, 5, 5]}
    assert ReachGoal().initial_state(make_setup(world_from(content, "mine")), draws()).goal.tolist() == [[3, 1]]


def test_it_observes_laser_distance_and_bearing_in_its_own_classes(make_setup):
    task = ReachGoal(distance_bins=(1.0, 2.0), bearing_bins=(0.0,))
    sensors = task.sensors(make_setup("wall", beams=4))
    assert [sensor.name for sensor in sensors] == ["laser", "goal distance", "goal bearing"]
    assert [sensor.bins for sensor in sensors] == [task.range_bins, (1.0, 2.0), (0.0,)]
