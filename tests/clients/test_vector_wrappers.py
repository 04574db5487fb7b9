"""Gymnasium's vector wrappers over the batches of both simulators."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import vector

from tb2rl.simulation.simulator import default_physics

RAW = "tb2rl:TurtleBot2MazeRaw-v0"
NUM_ENVS = 3


@pytest.fixture
def make():
    """`gymnasium.make_vec`, in the kinematic simulator by default; environments are closed after the test."""
    made = []

    def make_vec(env_id=RAW, **settings):
        settings = {"num_envs": NUM_ENVS, "simulation": "kinematic", "max_episode_steps": 9, **settings}
        made.append(gym.make_vec(env_id, **settings))
        return made[-1]

    yield make_vec
    for envs in made:
        envs.close()


def drive(envs, action=1, steps=30):
    """Results of `reset` and of steps over the ends of several episodes."""
    actions = np.full(NUM_ENVS, action)
    return [envs.reset(seed=3), *(envs.step(actions) for _ in range(steps))]


@pytest.mark.parametrize(
    ("settings", "wrapper"),
    [
        ({"simulation": default_physics().name}, vector.NormalizeReward),
        # Gymnasium has these wrappers only for the autoreset mode NEXT_STEP.
        ({"vectorization_mode": "sync"}, vector.NormalizeObservation),
        ({"autoreset_mode": "NEXT_STEP"}, lambda envs: vector.ReshapeObservation(envs, (2, 18))),
    ],
)
def test_a_wrapper_keeps_to_its_spaces_and_changes_no_episode(settings, wrapper, make):
    plain, wrapped = make(**settings), wrapper(make(**settings))
    for one, other in zip(drive(plain), drive(wrapped), strict=True):
        assert wrapped.observation_space.contains(other[0])
        assert np.isfinite(other[0]).all()
        np.testing.assert_array_equal(one[2:-1], other[2:-1])
        np.testing.assert_array_equal(one[-1]["pose"], other[-1]["pose"])


def test_infos_are_converted_to_a_list(make):
    envs, plain = vector.DictInfoToList(vector.RecordEpisodeStatistics(make())), make()
    ends = 0
    for (*_, infos), listed in zip(drive(plain), drive(envs), strict=True):
        for index, info in enumerate(listed[-1]):
            np.testing.assert_array_equal(info["pose"], infos["pose"][index])
            assert info["ended"] == infos["ended"][index]
            if "final_info" in info:
                ends += 1
                assert info["final_info"]["ended"] == infos["final_info"]["ended"][index] != ""
                assert 1 <= info["episode"]["l"] <= 9
                assert info["final_obs"].shape == (36,)
    assert ends >= 3 * NUM_ENVS
