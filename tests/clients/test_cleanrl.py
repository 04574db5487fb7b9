"""A single-file learner in the style of CleanRL (Huang et al. 2022) on Gymnasium's vector environments."""

import random

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import RecordEpisodeStatistics
from torch import nn

RAW = "tb2rl:TurtleBot2MazeRaw-v0"


def make_env(env_id, seed, index):
    def thunk():
        env = RecordEpisodeStatistics(gym.make(env_id, simulation="kinematic", max_episode_steps=50))
        env.action_space.seed(seed + index)
        return env

    return thunk


def dqn(seed, total_timesteps=150, num_envs=2, start=60, batch=32):
    """CleanRL's dqn.py, shortened; returns episodes (return, length), losses and the last observation."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 (as CleanRL does)
    th.manual_seed(seed)
    thunks = [make_env(RAW, seed, index) for index in range(num_envs)]
    envs = SyncVectorEnv(thunks, autoreset_mode=AutoresetMode.SAME_STEP)
    inputs, actions = int(np.prod(envs.single_observation_space.shape)), envs.single_action_space.n
    q_network = nn.Sequential(nn.Linear(inputs, 32), nn.ReLU(), nn.Linear(32, actions))
    optimizer = th.optim.Adam(q_network.parameters(), lr=1.0e-3)
    memory, episodes, losses = [], [], []
    obs, _ = envs.reset(seed=seed)
    for step in range(total_timesteps):
        if random.random() < max(0.05, 1.0 - step / start):
            chosen = np.array([envs.single_action_space.sample() for _ in range(num_envs)])
        else:
            chosen = q_network(th.tensor(obs)).argmax(dim=1).numpy()
        next_obs, rewards, terminations, truncations, infos = envs.step(chosen)
        real_next_obs = next_obs.copy()
        if "final_info" in infos:
            finished = infos["final_info"]["episode"]
            ended = infos["final_info"]["_episode"]
            episodes += zip(finished["r"][ended].tolist(), finished["l"][ended].tolist(), strict=True)
            for index in np.flatnonzero(truncations):
                real_next_obs[index] = infos["final_obs"][index]
        memory += zip(obs, real_next_obs, chosen, rewards, terminations, strict=True)
        obs = next_obs
        if step > start:
            rows = (np.array(column) for column in zip(*random.sample(memory, batch), strict=True))
            before, after, done, reward, over = (th.tensor(column) for column in rows)
            with th.no_grad():
                target = reward + 0.99 * q_network(after).max(dim=1).values * ~over
            value = q_network(before).gather(1, done[:, None])[:, 0]
            loss = nn.functional.mse_loss(value, target.float())
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
    envs.close()
    return episodes, losses, obs


def test_a_single_file_learner_learns_and_a_seed_repeats_it():
    episodes, losses, obs = dqn(seed=1)
    assert len(episodes) >= 2 * 150 // 50
    assert {length for _, length in episodes} <= set(range(1, 51))
    assert max(length for _, length in episodes) == 50
    assert np.isfinite(losses).all()
    again = dqn(seed=1)
    assert (again[0], again[1]) == (episodes, losses)
    np.testing.assert_array_equal(again[2], obs)


@pytest.mark.parametrize(
    ("mode", "simulation"), [(None, "kinematic"), ("sync", "bullet"), ("async", "kinematic"), (None, "bullet")]
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
