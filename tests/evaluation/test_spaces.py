"""A policy is judged only on what it was trained on: the observations and the actions that it knows."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.spaces import check_observes
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.tasks.wander import Wander


@pytest.mark.parametrize("change", [{"beams": 9}, {"range_bins": [1.0]}, {"name": "wall", "world": "wall"}])
def test_a_policy_is_not_judged_on_observations_that_it_was_not_trained_on(run, change):
    with pytest.raises(InputError, match="observation"):
        evaluate(run, settings=change, episodes=1, steps=2, workers=1)


def test_a_policy_is_not_judged_with_actions_that_it_does_not_know(cruise):
    policy = make_baseline(resolve("random"))
    with pytest.raises(InputError, match=r"knows the actions Discrete\(3\), but this task has Discrete\(4\)"):
        evaluate(policy, resolve("random", "my-maze"), episodes=1, steps=2, workers=1)
    with pytest.raises(InputError, match=r"knows the actions Discrete\(3\), but this task has Box\(-1"):
        evaluate(policy, resolve("random", cruise), episodes=1, steps=2, workers=1)


def test_a_policy_that_does_not_say_what_it_knows_is_taken_as_it_is():
    check_observes(SimpleNamespace(), make_scene(Wander(), "raw"))


def test_an_image_beside_numbers_is_compared_too(pictured):
    scene = make_scene(pictured(), "raw")
    numbers = scene.observation_space["numbers"]
    for side in (36, 37):
        known = spaces.Dict({"picture": spaces.Box(0, 255, (1, 36, side), np.uint8), "numbers": numbers})
        fits = nullcontext() if side == 36 else pytest.raises(InputError, match="knows the observation")
        with fits:
            check_observes(SimpleNamespace(observation_space=known), scene)
