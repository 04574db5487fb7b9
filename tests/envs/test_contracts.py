"""What Gymnasium and Stable-Baselines3 ask of an environment, of all kinds that there are."""

import os
import subprocess
import sys

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import tb2rl
from tb2rl.core.plugins import robot_names
from tb2rl.envs.parts import SENSORS

ROBOTS = robot_names()


@pytest.mark.parametrize(
    ("name", "robot", "simulation"),
    [(name, ROBOTS[i % len(ROBOTS)], ("bullet", "kinematic")[i // 2 % 2]) for i, name in enumerate(tb2rl.GYM_IDS)],
)
def test_every_id_keeps_the_contracts_of_gymnasium_and_stable_baselines3(name, robot, simulation):
    env = gym.make(f"tb2rl:{name}", robot=robot, simulation=simulation, render_mode="rgb_array").unwrapped
    check_env(env)
    check_env_for_sb3(env, skip_render_check=False)  # closes it, and goes on
    env.close()


@pytest.mark.parametrize(("robot", "observation"), [("turtlebot3", "raw"), ("jackal", "discrete")])
def test_so_does_a_task_of_any_velocities(robot, observation, glide, make):
    env = make(glide, observation, simulation="kinematic", robot=robot)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


@pytest.mark.parametrize(
    ("observe", "observation", "simulation", "frame_stack"),
    [
        ([name for name in SENSORS if name != "camera"], "discrete", "kinematic", 1),
        ([*SENSORS], "raw", "bullet", 1),
        (["laser", "camera"], "raw", "kinematic", 3),
        (["camera"], "raw", "kinematic", 3),
        ([{"camera": {"colour": True}}], "raw", "bullet", 1),
    ],
)
def test_so_does_every_sensor_that_can_be_listed(observe, observation, simulation, frame_stack, make):
    env = make("wall", observation, simulation=simulation, observe=observe, frame_stack=frame_stack)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


SCRIPT = """
import hashlib
import gymnasium
import tb2rl
for name in tb2rl.GYM_IDS:
    env = gymnasium.make(name, laser_noise=0.01)
    env.action_space.seed(5)
    seen, info = env.reset(seed=4)
    digest = hashlib.sha256(seen.tobytes() + info["pose"].tobytes())
    for _ in range(150):
        seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
        digest.update(seen.tobytes() + info["pose"].tobytes() + repr(reward).encode())
        if terminated or truncated:
            digest.update(env.reset()[0].tobytes())
    print(digest.hexdigest())
"""


@pytest.mark.slow
def test_the_same_seed_and_actions_give_the_same_trajectory_to_the_bit_in_another_process():
    outputs = [
        subprocess.check_output([sys.executable, "-c", SCRIPT], env={**os.environ, "PYTHONHASHSEED": seed}, text=True)
        for seed in ("1", "2")
    ]
    assert outputs[0] == outputs[1]
    assert len(set(outputs[0].split())) == len(tb2rl.GYM_IDS)
