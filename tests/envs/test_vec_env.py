"""Many environments for Stable-Baselines3: how episodes end and begin, alike in one environment and in many."""

from dataclasses import replace

import numpy as np
import pytest

import tb2rl
from tb2rl.envs.encodings import take_rows
from tb2rl.envs.make import make_task
from tb2rl.tasks.wander import Wander

CAMERA = ["laser", {"camera": {"width": 12, "height": 9}}]


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch, start_vec_env):
    def run():
        env, observations = start_vec_env(Wander(laser_noise=0.01, episode_steps=20), num_envs=600)
        for _ in range(50):
            observations, *_ = env.step((observations[:, 0] * 100).astype(int) % 3)
        return observations

    monkeypatch.setattr("tb2rl.core.threads.MIN_PARALLEL_TIME", 0.0)
    monkeypatch.setattr("tb2rl.core.threads.THREADS", 1)
    alone = run()
    monkeypatch.setattr("tb2rl.core.threads.THREADS", 3)
    np.testing.assert_array_equal(run(), alone)


def test_path_lengths_are_those_of_each_environment_where_episodes_end(start_vec_env):
    task = make_task("navigate", {"world": "maze", "episode_steps": 30})
    (env, _), ended = start_vec_env(task, num_envs=20), []
    for _ in range(29):
        *_, dones, _ = env.step(np.tile((1.0, 0.0), (20, 1)))
        robot_state = env.loop.robot_state
        if dones.any():
            ended.append(dones.sum())
            np.testing.assert_array_equal(vars(robot_state)["path_length"], replace(robot_state).path_length)
    assert len(ended) > 5
    assert max(ended) < 20


def test_an_episode_ends_as_stable_baselines3_expects(start_vec_env):
    env, _ = start_vec_env(Wander(episode_steps=40), "discrete", 64, reward_scale=0.5)
    rng, endings, returns = np.random.default_rng(0), set(), np.zeros(64)
    for _ in range(100):
        _, rewards, dones, infos = env.step(rng.choice(3, size=64, p=[0.2, 0.5, 0.3]))
        returns += rewards / 0.5
        assert [bool(info) for info in infos] == dones.tolist()
        for i in dones.nonzero()[0]:
            endings.add(infos[i]["ended"])
            assert infos[i]["episode"]["r"] == pytest.approx(returns[i])
            assert infos[i]["episode"]["l"] == 40 or infos[i]["failed"]
            returns[i] = 0.0
    assert endings == {"collision", "time limit"}


@pytest.mark.parametrize(
    ("simulation", "observation", "settings"),
    [
        ("bullet", "raw", {}),
        ("kinematic", "discrete", {"frame_stack": 3}),
        ("bullet", "raw", {"observe": CAMERA, "frame_stack": 2}),
        ("kinematic", "raw", {"observe": CAMERA}),
    ],
)
def test_each_environment_is_a_gymnasium_environment(simulation, observation, settings, make, start_vec_env):
    task = Wander(start="fixed", episode_steps=50, **settings)
    many, first = start_vec_env(task, observation, 2, simulation=simulation)
    envs, ends = [make(task, observation, simulation=simulation) for _ in range(2)], set()
    np.testing.assert_equal([take_rows(first, i) for i in range(2)], [env.reset()[0] for env in envs])
    for actions in np.random.default_rng(1).choice(3, size=(150, 2), p=[0.3, 0.4, 0.3]):
        observations, rewards, dones, infos = many.step(actions)
        for i, (env, action) in enumerate(zip(envs, actions, strict=True)):
            seen, reward, terminated, truncated, info = env.step(action)
            assert (rewards[i], dones[i]) == (reward, terminated or truncated)
            if dones[i]:
                ends.add(info["ended"])
                assert infos[i]["TimeLimit.truncated"] == (truncated and not terminated)
                assert infos[i]["distance"] == pytest.approx(info.pop("distance"))
                np.testing.assert_equal(infos[i]["terminal_observation"], seen)
                np.testing.assert_equal({name: infos[i][name] for name in info}, info)
                seen, _ = env.reset()
            np.testing.assert_equal(take_rows(observations, i), seen)
    many.close()
    assert ends == {"collision", "time limit"}


@pytest.mark.slow
def test_a_policy_is_as_good_in_every_simulator():
    """50 episodes of 1 500 control steps from the same initial states."""
    rates = [
        tb2rl.evaluate("zoo:maze-loop-dqn", episodes=50, simulation=simulation).summary()["failure_free_rate"]
        for simulation in ("bullet", "mujoco", "kinematic")
    ]
    assert rates == pytest.approx([rates[0]] * 3, abs=0.02)
