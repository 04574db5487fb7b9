"""Gymnasium's vector environments as a single-file learner in the style of CleanRL (Huang et al. 2022) uses them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import RecordEpisodeStatistics

RAW = "tb2rl:TurtleBot2MazeRaw-v0"


def collect(seed, steps=150, num_envs=2):
    """Transitions of random actions with the final observation of each episode, and episodes (return, length)."""
    thunks = [lambda: RecordEpisodeStatistics(gym.make(RAW, simulation="kinematic", max_episode_steps=50))] * num_envs
    envs = SyncVectorEnv(thunks, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.action_space.seed(seed)
    obs, _ = envs.reset(seed=seed)
    memory, episodes = [], []
    for _ in range(steps):
        next_obs, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
        real_next_obs = next_obs.copy()
        if "final_info" in infos:
            finished, ended = infos["final_info"]["episode"], infos["final_info"]["_episode"]
            np.testing.assert_array_equal(ended, terminations | truncations)
            episodes += zip(finished["r"][ended].tolist(), finished["l"][ended].tolist(), strict=True)
            for index in np.flatnonzero(ended):
                real_next_obs[index] = infos["final_obs"][index]
        memory.append((obs, real_next_obs, rewards, terminations))
        obs = next_obs
    envs.close()
    return episodes, memory


def test_equal_seeds_collect_equal_episodes():
    episodes, memory = collect(seed=1)
    assert len(episodes) >= 2 * 150 // 50
    assert {length for _, length in episodes} <= set(range(1, 51))
    again, same = collect(seed=1)
    assert again == episodes
    for one, other in zip(memory, same, strict=True):
        for column, equal in zip(one, other, strict=True):
            np.testing.assert_array_equal(column, equal)


@pytest.mark.parametrize(
    ("mode", "simulation"),
    [(None, "kinematic"), ("sync", "bullet"), pytest.param("async", "kinematic", marks=pytest.mark.slow)],
)
def test_recorded_returns_and_lengths_are_those_of_the_episodes(mode, simulation):
    """Compares the sums of Gymnasium's wrapper with our sums over several episodes."""
    made = gym.make_vec(RAW, num_envs=3, vectorization_mode=mode, simulation=simulation, max_episode_steps=9)
    envs = gym.wrappers.vector.RecordEpisodeStatistics(made)
    same_step = envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    envs.reset(seed=1)
    returns, lengths, ended = np.zeros(3), np.zeros(3, int), np.zeros(3, bool)
    recorded = []
    for _ in range(30):
        counted = np.ones(3, bool) if same_step else ~ended  # the others only reset
        _, rewards, terminated, truncated, infos = envs.step(np.array([0, 1, 2]))
        returns, lengths, ended = returns + rewards * counted, lengths + counted, terminated | truncated
        np.testing.assert_array_equal(infos.get("_episode", np.zeros(3, bool)), ended)
        for index in np.flatnonzero(ended):
            recorded.append((infos["final_info"] if same_step else infos)["ended"][index])
            assert infos["episode"]["r"][index] == pytest.approx(returns[index])
            assert infos["episode"]["l"][index] == lengths[index]
        returns[ended], lengths[ended] = 0.0, 0
    envs.close()
    assert len(recorded) >= 9
    assert "time limit" in recorded
