"""TurtleBot2Maze: rewards and endings of several environments at once."""

import math

import numpy as np

from tb2rl.tasks.wander import Wander

FAR, INF = 3.0, math.inf


def test_straight_on_earns_more_than_a_turn_and_a_collision_replaces_the_reward_of_its_own_environment(
    make_robot_state,
):
    after = make_robot_state([FAR, 0.51, INF, 0.49, 0.3, FAR], bumped=[False] * 5 + [True])
    outcome = Wander().outcome(after, np.array([0, 1, 2, 0, 1, 0]), after)
    assert outcome.reward.tolist() == [5, 1, 1, -200, -200, -200]
    assert outcome.failed["collision"].tolist() == outcome.terminated.tolist() == [False] * 3 + [True] * 3
    assert outcome.succeeded is None
    assert Wander().actions.table.tolist() == [[0.5, 0], [0.05, 1], [0.05, -1]]  # left is counter-clockwise
