"""TurtleBot2Maze: rewards and endings of several environments at once."""

import math

import numpy as np

from tb2rl.tasks.wander import Wander

FAR, INF = 3.0, math.inf


def outcome_of(task, action, after):
    return task.outcome(after, np.array(action), after)


def test_driving_straight_is_rewarded_and_turning_a_little(make_robot_state):
    task = Wander()
    actions = task.actions
    outcome = outcome_of(task, [actions.forward, actions.left, actions.right], make_robot_state([FAR, 0.51, INF]))
    assert outcome.reward.tolist() == [5, 1, 1]
    assert not outcome.terminated.any()
    assert actions.table.tolist() == [[0.5, 0], [0.05, 1], [0.05, -1]]  # left is counter-clockwise


def test_a_collision_replaces_the_reward_of_its_own_environment_only(make_robot_state):
    after = make_robot_state([0.49, 0.51, 0.3, FAR], bumped=[False, False, False, True])
    outcome = outcome_of(Wander(), [0, 0, 1, 0], after)
    assert outcome.reward.tolist() == [-200, 5, -200, -200]
    assert outcome.failed["collision"].tolist() == [True, False, True, True]
    assert outcome.terminated.tolist() == [True, False, True, True]
    assert outcome.succeeded is None


def test_wanders_numbers_are_settings(make_robot_state):
    task = Wander(collision_range=1.0, collision_reward=-1.0, forward_reward=0.1, turn_reward=0.0, turn_rate=0.3)
    assert outcome_of(task, [0, 1, 0], make_robot_state([FAR, FAR, 0.9])).reward.tolist() == [0.1, 0, -1]
    assert task.actions.table[1:, 1].tolist() == [0.3, -0.3]
    other = Wander(forward_speed=0.2, turn_speed=0.1)
    assert other.actions.table[:, 0].tolist() == [0.2, 0.1, 0.1]
