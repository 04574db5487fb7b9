"""Gymnasium's wrappers of vectors, over the twin's batch and over PyBullet's environments."""

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers import vector

RAW = "tb2rl:TurtleBot2MazeRaw-v0"
ROBOTS = 3


@pytest.fixture(params=("bullet", "kinematic"))
def make(request):
    """`gymnasium.make_vec` for some robots; closed after the test."""
    made = []

    def make_vec(env_id=RAW, **settings):
        settings = {"num_envs": ROBOTS, "simulation": request.param, "max_episode_steps": 9, **settings}
        made.append(gym.make_vec(env_id, **settings))
        return made[-1]

    yield make_vec
    for envs in made:
        envs.close()


def drive(envs, action=1, steps=30):
    """Answers of `step` over the ends of several episodes, after that of `reset`."""
    actions = np.full(ROBOTS, action)
    return [envs.reset(seed=3), *(envs.step(actions) for _ in range(steps))]


REWARDS = {
    "NormalizeReward": vector.NormalizeReward,
    "ClipReward": lambda envs: vector.ClipReward(envs, -1.0, 0.5),
    "TransformReward": lambda envs: vector.TransformReward(envs, lambda reward: 0.1 * reward),
}
OBSERVATIONS = {
    "RescaleObservation": lambda envs: vector.RescaleObservation(envs, np.float32(0.0), np.float32(1.0)),
    "ReshapeObservation": lambda envs: vector.ReshapeObservation(envs, (2, 18)),
    "NormalizeObservation": vector.NormalizeObservation,
}


@pytest.mark.parametrize("name", REWARDS)
def test_other_rewards_of_the_same_episodes(name, make):
    rewards = []
    for plain, other in zip(drive(make())[1:], drive(REWARDS[name](make()))[1:], strict=True):
        np.testing.assert_array_equal(plain[0], other[0])
        np.testing.assert_array_equal(plain[2:-1], other[2:-1])
        np.testing.assert_array_equal(plain[-1]["pose"], other[-1]["pose"])
        rewards.append((plain[1], other[1]))
    plain, other = np.moveaxis(rewards, 0, 1)
    assert np.isfinite(other).all()
    assert not np.array_equal(plain, other)


@pytest.mark.parametrize("settings", [{"vectorization_mode": "sync"}, {"autoreset_mode": "NEXT_STEP"}])
@pytest.mark.parametrize("name", OBSERVATIONS)
def test_other_observations_of_the_same_episodes(name, settings, make):
    """Gymnasium has these wrappers only for environments that begin anew a step later."""
    wrapped = OBSERVATIONS[name](make(**settings))
    for plain, other in zip(drive(make(**settings)), drive(wrapped), strict=True):
        assert wrapped.observation_space.contains(other[0])
        assert np.isfinite(other[0]).all()
        np.testing.assert_array_equal(plain[-1]["pose"], other[-1]["pose"])


def test_classes_are_flattened_to_ones_and_zeros(make):
    envs = vector.FlattenObservation(make("tb2rl:TurtleBot2Maze-v0", vectorization_mode="sync"))
    assert isinstance(envs.single_observation_space, spaces.Box)
    for seen, *_ in drive(envs):
        assert envs.observation_space.contains(seen)
        assert set(np.unique(seen)) == {0, 1}


class OnlyNumbers(VectorWrapper):
    """Keeps of the infos what a tensor can hold: no words, and no objects where episodes end."""

    def reset(self, **arguments):
        return self._with_numbers(*self.env.reset(**arguments))

    def step(self, actions):
        return self._with_numbers(*self.env.step(actions))

    def _with_numbers(self, *answer):
        *others, infos = answer
        return *others, {k: v for k, v in infos.items() if isinstance(v, np.ndarray) and v.dtype.kind in "fiu"}


@pytest.mark.parametrize("mode", [None, "sync"])
def test_tensors_are_the_same_numbers(mode, make):
    pytest.importorskip("array_api_compat", reason="array-api-compat is not installed (gymnasium[torch])")
    envs = vector.NumpyToTorch(OnlyNumbers(make(vectorization_mode=mode)))
    plain, actions = make(vectorization_mode=mode), np.arange(ROBOTS)
    answers = [(plain.reset(seed=3), envs.reset(seed=3))]
    answers += [(plain.step(actions), envs.step(th.from_numpy(actions))) for _ in range(30)]
    for numbers, tensors in answers:
        for one, other in zip(numbers[:-1], tensors[:-1], strict=True):
            assert isinstance(other, th.Tensor)
            np.testing.assert_array_equal(one, other.numpy())
        np.testing.assert_array_equal(numbers[-1]["pose"], tensors[-1]["pose"].numpy())


def test_infos_come_as_a_list(make):
    envs, plain = vector.DictInfoToList(vector.RecordEpisodeStatistics(make())), make()
    ends = 0
    for (*_, infos), listed in zip(drive(plain), drive(envs), strict=True):
        for robot, info in enumerate(listed[-1]):
            np.testing.assert_array_equal(info["pose"], infos["pose"][robot])
            assert info["ended"] == infos["ended"][robot]
            if "final_info" in info:
                ends += 1
                assert info["final_info"]["ended"] == infos["final_info"]["ended"][robot] != ""
                assert 1 <= info["episode"]["l"] <= 9
                assert info["final_obs"].shape == (36,)
    assert ends >= 3 * ROBOTS
