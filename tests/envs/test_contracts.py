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
from tb2rl.envs.encodings import BEAMS
from tb2rl.sensors.names import SENSORS
from tb2rl.worlds.registry import world_names


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("observation", BEAMS)
@pytest.mark.parametrize("robot", robot_names())
@pytest.mark.parametrize("name", tb2rl.GYM_IDS)
def test_every_id_keeps_the_contracts_of_gymnasium_and_stable_baselines3(name, robot, observation, simulation):
    modes = {"robot": robot, "observation": observation, "simulation": simulation, "render_mode": "rgb_array"}
    env = gym.make(f"tb2rl:{name}", **modes).unwrapped
    check_env(env, skip_render_check="human" in env.metadata["render_modes"])  # it would open the window
    check_env_for_sb3(env, skip_render_check=False)  # closes it, and goes on
    env.close()


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("robot", robot_names())
@pytest.mark.parametrize("observation", BEAMS)
def test_so_does_a_task_of_any_velocities(observation, robot, simulation, glide, make):
    env = make(glide, observation, simulation=simulation, robot=robot)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_so_does_a_task_that_observes_images(simulation, image_task, make):
    env = make(image_task, "raw", simulation=simulation)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


CAMERAS = {"depth": {}, "colour": {"colour": True, "depth": False}, "both": {"colour": True}}
LISTS = {name: [name] for name in SENSORS} | {name: [{"camera": kind}] for name, kind in CAMERAS.items()}
LISTS |= {"all": [*SENSORS], "camera and laser": ["camera", "laser"]}


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("observation", BEAMS)
@pytest.mark.parametrize("name", LISTS)
def test_so_does_every_sensor_that_can_be_listed(name, observation, simulation, make):
    seen = name in {"all", "camera and laser", "camera", *CAMERAS}
    if (seen and observation == "discrete") or (name in {"colour", "both"} and simulation == "kinematic"):
        with pytest.raises(InputError, match="camera"):
            make("wall", observation, simulation=simulation, observe=LISTS[name])
        return
    env = make("wall", observation, simulation=simulation, observe=LISTS[name])
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


@pytest.mark.parametrize("world", world_names())
def test_gymnasium_makes_it_in_any_world(world):
    env = gym.make("tb2rl:TurtleBot2Maze-v0", world=world, observation="raw")
    seen, info = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert env.unwrapped.scene.world.name == world
    assert env.unwrapped.scene.world.clearance(*info["pose"][:2]) >= 0.6 - 1e-3
    env.close()


SCRIPT = """
import hashlib
import gymnasium
import tb2rl
for name in tb2rl.GYM_IDS:
    env = gymnasium.make(name, laser_noise=0.01)
    env.action_space.seed(5)
    seen, info = env.reset(seed=4)
    digest = hashlib.sha256(seen.tobytes() + info["pose"].tobytes())
    episodes = 0
    for _ in range(150):
        seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
        digest.update(seen.tobytes() + info["pose"].tobytes() + repr(reward).encode())
        if terminated or truncated:
            episodes += 1
            digest.update(env.reset()[0].tobytes())
    print(digest.hexdigest(), episodes)
"""


@pytest.mark.slow
def test_the_same_seed_and_actions_give_the_same_trajectory_to_the_bit_in_another_process():
    started = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT],
            env={**os.environ, "PYTHONHASHSEED": seed},
            stdout=subprocess.PIPE,
            text=True,
        )
        for seed in ("1", "2")
    ]
    outputs = [process.communicate()[0] for process in started]
    assert outputs[0] == outputs[1]
    assert len(set(outputs[0].split("\n"))) == len(tb2rl.GYM_IDS) + 1  # each has its own
