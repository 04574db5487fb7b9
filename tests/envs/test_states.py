"""States and copies: every kind of memory continues to the bit, and no environment depends on the others."""

import copy

import numpy as np
import pytest

from tb2rl.envs.encodings import take_rows
from tb2rl.envs.make import make_task
from tb2rl.envs.vec_env import TurtleBot2VecEnv

OBSTACLES = [{"people": 3, "speed": 1.0}, {"boxes": 1}]
LATENCIES = {"preset": "strong", "latency": [1, 3], "observation_latency": [0, 2]}
LATE = {"variation": LATENCIES, "frame_stack": 2, "observe": ["laser", {"last_action": {"count": 5}}]}
CAMERA = {"observe": ["laser", {"camera": {"width": 12, "height": 9}}], "frame_stack": 2}
SETTINGS = {
    "goal": ("wall", {}),
    "latencies": ("maze", LATE),
    "dynamic obstacles": ("maze", {"dynamic_obstacles": OBSTACLES, "variation": "strong"}),
    "images": ("maze", CAMERA),
    "occupancy map": ("navigate", {"world": "maze", "guide": "plan", "map": "online"}),
    "pose history": ("drive", {"world": "loop", "observe": ["visited"]}),
}


@pytest.fixture(params=SETTINGS)
def task(request):
    """A task whose episodes of 15 steps have something to remember."""
    name, settings = SETTINGS[request.param]
    return make_task(name, {"laser_noise": 0.01, "episode_steps": 15, **settings})


def random_actions(space, *shape):
    rng = np.random.default_rng(0)
    return rng.integers(space.n, size=shape) if space.shape == () else rng.uniform(-1.0, 1.0, (*shape, 2))


def test_a_vec_env_continues_from_its_state_and_as_a_copy(task, start_vec_env):
    env, _ = start_vec_env(task, num_envs=6)
    actions = random_actions(env.action_space, 40, 6)
    for each in actions[:20]:
        env.step(each)
    state, copied, fresh = env.loop.state(), copy.deepcopy(env), TurtleBot2VecEnv(env.loop.scene, 6)
    expected = [env.step(each) for each in actions[20:]]
    fresh.loop.restore(state)
    env.loop.restore(state)
    for other in (env, fresh, copied):
        for each, answer in zip(actions[20:], expected, strict=True):
            np.testing.assert_equal(other.step(each), answer)


def test_an_environment_does_not_depend_on_the_others(task, start_vec_env):
    (many, first), (few, same) = start_vec_env(task, num_envs=30), start_vec_env(task, num_envs=5)
    indices = np.arange(5)
    for actions in random_actions(many.action_space, 40, 30):
        np.testing.assert_equal(take_rows(first, indices), same)
        first, rewards, dones, _ = many.step(actions)
        same, same_rewards, same_dones, _ = few.step(actions[:5])
        np.testing.assert_array_equal((rewards[:5], dones[:5]), (same_rewards, same_dones))


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
def test_one_environment_continues_from_its_state_and_as_a_copy(task, simulation, make, drive):
    env, fresh = (make(task, "raw", simulation=simulation) for _ in range(2))
    env.reset(seed=3)
    actions = random_actions(env.action_space, 18)
    drive(env, actions[:4])
    state = copy.deepcopy(env.state())  # PyBullet rounds here, so the copy comes after it
    copied = copy.deepcopy(env)
    fresh.restore(state)
    np.testing.assert_equal(fresh.robot_state.state(), env.robot_state.state())

    def rest(each):
        return drive(each, actions[4:]), each.reset(), drive(each, actions[:3])

    expected = rest(env)
    for other in (fresh, copied):
        np.testing.assert_equal(rest(other), expected)
    copied.close()
