"""TurtleBot2Drive rewards metres driven, and less in a circle."""

import math

import numpy as np
import pytest

from tb2rl.tasks.drive import Drive

STAND = np.zeros((1, 2), np.float32)


def reward(after, action=STAND, **settings):
    return Drive(**settings).outcome(after, action, after).reward


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
