"""TurtleBot2Drive rewards metres driven, and less in a circle."""

import math

import numpy as np
import pytest

from tb2rl.tasks.drive import Drive
from tb2rl.tasks.wander import Wander

STAND = np.zeros((1, 2), np.float32)


def reward(after, action=STAND, **settings):
    return Drive(**settings).outcome(after, action, after).reward


def test_actions_span_all_speeds_and_turn_rates():
    actions = Drive().actions
    ends = actions.commands(np.array([[-1.0, -1.0], [1.0, 1.0], [-1.0, 0.0]]))
    assert ends.tolist() == [[0.0, -2.0], [0.65, 2.0], [0.0, 0.0]]
    other = Drive(max_speed=0.3, turn_rate=1.0).actions
    assert other.commands(np.ones((1, 2))).tolist() == [[0.3, 1.0]]


def test_a_step_is_rewarded_by_the_metres_driven_whatever_the_action(make_robot_state):
    after = make_robot_state(twist=[(0.65, 0.0), (0.2, 0.0), (0.0, 0.0)])
    for action in (STAND, STAND + 1.0):
        assert reward(after, np.repeat(action, 3, axis=0)) == pytest.approx([0.13, 0.04, 0.0])
    assert reward(after, control_period=0.1) == pytest.approx([0.065, 0.02, 0.0])


def test_a_circle_on_one_spot_earns_little_and_turning_fast_costs(make_robot_state):
    straight, circle, spinning = reward(make_robot_state(twist=[(0.65, 0.0), (0.65, 1.3), (0.1, 2.0)]))
    assert circle == pytest.approx(straight * math.cos(1.3))
    assert circle < 0.3 * straight
    assert spinning < 0 < circle


def test_a_wide_circle_can_cost_more_than_a_sharp_turn_now_and_then(make_robot_state):
    after = make_robot_state(twist=[(0.65, 0.0), (0.65, 0.2), (0.65, 1.0)])
    for cost, better in ((0.0, False), (0.3, True)):
        straight, circle, sharp = reward(after, turn_cost=cost)
        assert straight == pytest.approx(0.13)
        assert ((4 * straight + sharp) / 5 > circle) == better, "both turn by 0.2 rad in 0.2 s on average"
    assert sharp == pytest.approx(0.13 * (math.cos(1.0) - 0.3 / 1.3))


def test_a_collision_is_that_of_wander(make_robot_state):
    after = make_robot_state([0.49, 0.51, 3.0], bumped=[False, False, True], twist=[(0.5, 0.0)] * 3)
    mine, theirs = (task.outcome(after, np.zeros(3), after) for task in (Drive(), Wander()))
    assert mine.terminated.tolist() == theirs.terminated.tolist() == [True, False, True]
    assert mine.failed.keys() == theirs.failed.keys() == {"collision"}
    assert mine.reward.tolist() == pytest.approx([-2.0, 0.1, -2.0])
    assert mine.succeeded is None
