"""What Gymnasium and Stable-Baselines3 ask of an environment, of all kinds that there are."""

import os
import subprocess
import sys

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import robot_names
from tb2rl.sensors.names import SENSORS
from tb2rl.worlds.registry import world_names

ROBOTS = robot_names()


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize(("name", "robot"), [(name, ROBOTS[i % len(ROBOTS)]) for i, name in enumerate(tb2rl.GYM_IDS)])
def test_every_id_keeps_the_contracts_of_gymnasium_and_stable_baselines3(name, robot, simulation):
    env = gym.make(f"tb2rl:{name}", robot=robot, simulation=simulation, render_mode="rgb_array").unwrapped
    check_env(env, skip_render_check="human" in env.metadata["render_modes"])  # it would open the window
    check_env_for_sb3(env, skip_render_check=False)  # closes it, and goes on
    env.close()


@pytest.mark.parametrize(("robot", "observation"), [("turtlebot3", "raw"), ("jackal", "discrete")])
def test_so_does_a_task_of_any_velocities(robot, observation, glide, make):
    env = make(glide, observation, simulation="kinematic", robot=robot)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


@pytest.mark.parametrize("frame_stack", [1, 3])
def test_so_does_a_task_that_observes_images(frame_stack, image_task, make):
    env = make(image_task, "raw", simulation="kinematic", frame_stack=frame_stack)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


BOTH = [{"camera": {"colour": True}}]


@pytest.mark.parametrize(
    ("observe", "observation", "simulation"),
    [
        *(([name], "discrete", "kinematic") for name in SENSORS if name != "camera"),
        ([*SENSORS], "raw", "bullet"),
        (["camera"], "raw", "kinematic"),
        (BOTH, "raw", "bullet"),
    ],
)
def test_so_does_every_sensor_that_can_be_listed(observe, observation, simulation, make):
    env = make("wall", observation, simulation=simulation, observe=observe)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


@pytest.mark.parametrize(("observation", "simulation"), [("discrete", "bullet"), ("raw", "kinematic")])
def test_a_camera_that_cannot_be_observed_is_refused(observation, simulation, make):
    with pytest.raises(InputError, match="camera"):
        make("wall", observation, simulation=simulation, observe=BOTH)


@pytest.mark.parametrize("world", world_names())
def test_gymnasium_makes_it_in_any_world(world):
    env = gym.make("tb2rl:TurtleBot2Maze-v0", world=world, simulation="kinematic")
    seen, info = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert env.unwrapped.scene.world.name == world
    assert env.unwrapped.scene.world.clearance(*info["pose"][:2]) >= 0.6 - 1e-3


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
