"""Random actions of any kind, for any observations."""

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from tb2rl.agents.random import RandomPolicy

NUMBERS, IMAGE = spaces.Box(-1, 1, (5,)), spaces.Box(0, 255, (3, 36, 36), np.uint8)


@pytest.mark.parametrize(
    ("observation_space", "action_space"),
    [
        (spaces.MultiDiscrete([3, 4]), spaces.Discrete(4)),
        (spaces.Dict({"image": IMAGE, "numbers": NUMBERS}), spaces.Box(np.float32([-1, 0]), np.float32([1, 5]))),
    ],
)
def test_actions_are_uniform_for_any_observation(observation_space, action_space):
    policy = RandomPolicy(observation_space, action_space)
    th.manual_seed(0)
    assert action_space.contains(policy.predict(observation_space.sample())[0])
    observations = batch_space(observation_space, 400).sample()
    actions = np.concatenate([policy.predict(observations)[0] for _ in range(10)])
    assert all(action_space.contains(action) for action in actions)
    if isinstance(action_space, spaces.Discrete):
        assert np.bincount(actions) / 4000 == pytest.approx(0.25, abs=0.03)
        return
    for numbers, low, high in zip(actions.T, (-1, 0), (1, 5), strict=True):
        shares, _ = np.histogram(numbers, bins=4, range=(low, high))
        assert shares / 4000 == pytest.approx(0.25, abs=0.03)
