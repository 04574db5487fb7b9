"""What networks make of raw observations."""

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from tb2rl.envs.encodings import SensorBox
from tb2rl.envs.features import InverseRange
from tb2rl.envs.scene import make_scene
from tb2rl.sensors.motion import Visited
from tb2rl.tasks.reach_goal import ReachGoal


def features(space, values, **arguments):
    return InverseRange(space, **arguments)(th.tensor([values], dtype=th.float32))[0].tolist()


def test_distances_become_nearness_and_other_numbers_are_scaled():
    space = make_scene(ReachGoal(beams=2), "raw").observation_space
    assert space.units == ("m", "m", "m", "rad")
    seen = features(space, [0.5, 3.0, 1.0, np.pi / 2])
    assert seen == pytest.approx([1 / 1.5, 1 / 4, 1 / 2, 0.5])


def test_a_time_counts_in_units_of_ten_seconds():
    assert features(SensorBox([Visited(count=1)]), [1.0, 10.0, 60.0]) == pytest.approx([0.1, 1.0, 6.0])


def test_numbers_of_a_plain_box_are_distances_but_for_those_with_a_sign_and_the_curve_has_arguments():
    assert features(spaces.Box(np.float32([0, -2]), np.float32([30, 4])), [1.0, -2.0]) == pytest.approx([0.5, -0.5])
    seen = features(spaces.Box(0, 30, (3,)), [0.5, 1.0, 0.0], middle=0.5, spread=2.0, offset=0.25)
    assert seen == pytest.approx([2 * (1 / 0.75 - 0.5), 2 * (1 / 1.25 - 0.5), 2 * (1 / 0.35 - 0.5)])  # 0.1 m at least
