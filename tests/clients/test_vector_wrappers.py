"""Gymnasium's vector wrappers over the batches of both simulators."""

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers import vector

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


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_wrapped_rewards_of_the_same_episodes(simulation, make):
    rewards = []
    plain, wrapped = make(simulation=simulation), vector.NormalizeReward(make(simulation=simulation))
    for one, other in zip(drive(plain)[1:], drive(wrapped)[1:], strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[2:-1], other[2:-1])
        np.testing.assert_array_equal(one[-1]["pose"], other[-1]["pose"])
        rewards.append((one[1], other[1]))
    one, other = np.moveaxis(rewards, 0, 1)
    assert np.isfinite(other).all()
    assert not np.array_equal(one, other)


@pytest.mark.parametrize(
    ("settings", "wrapper"),
    [
        ({"vectorization_mode": "sync"}, vector.NormalizeObservation),
        ({"autoreset_mode": "NEXT_STEP"}, lambda envs: vector.ReshapeObservation(envs, (2, 18))),
    ],
)
def test_wrapped_observations_of_the_same_episodes(settings, wrapper, make):
    """Gymnasium has these wrappers only for the autoreset mode NEXT_STEP."""
    wrapped = wrapper(make(**settings))
    for one, other in zip(drive(make(**settings)), drive(wrapped), strict=True):
        assert wrapped.observation_space.contains(other[0])
        assert np.isfinite(other[0]).all()
        np.testing.assert_array_equal(one[-1]["pose"], other[-1]["pose"])


def test_bins_are_flattened_to_ones_and_zeros(make):
    envs = vector.FlattenObservation(make("tb2rl:TurtleBot2Maze-v0", vectorization_mode="sync"))
    assert isinstance(envs.single_observation_space, spaces.Box)
    for observation, *_ in drive(envs):
        assert envs.observation_space.contains(observation)
        assert set(np.unique(observation)) == {0, 1}


class NumericInfos(VectorWrapper):
    """Keeps only the infos that a tensor can hold."""

    def reset(self, **arguments):
        return self._numeric(*self.env.reset(**arguments))

    def step(self, actions):
        return self._numeric(*self.env.step(actions))

    def _numeric(self, *results):
        *others, infos = results
        return *others, {k: v for k, v in infos.items() if isinstance(v, np.ndarray) and v.dtype.kind in "fiu"}


@pytest.mark.parametrize("mode", [None, "sync"])
def test_tensors_have_the_same_numbers(mode, make):
    pytest.importorskip("array_api_compat", reason="array-api-compat is not installed (gymnasium[torch])")
    envs = vector.NumpyToTorch(NumericInfos(make(vectorization_mode=mode)))
    plain, actions = make(vectorization_mode=mode), np.arange(NUM_ENVS)
    results = [(plain.reset(seed=3), envs.reset(seed=3))]
    results += [(plain.step(actions), envs.step(th.from_numpy(actions))) for _ in range(30)]
    for numbers, tensors in results:
        for one, other in zip(numbers[:-1], tensors[:-1], strict=True):
            assert isinstance(other, th.Tensor)
            np.testing.assert_array_equal(one, other.numpy())
        np.testing.assert_array_equal(numbers[-1]["pose"], tensors[-1]["pose"].numpy())


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
