"""Commands that take effect late and observations that arrive late."""

import numpy as np
import pytest

from tb2rl.tasks.wander import Wander

ACTIONS = [1, 0, 2, 0, 1, 1, 0]


@pytest.fixture
def run(make):
    """A function from settings to an environment, and the observations and robot states of an episode in it."""

    def run_episode(simulation="kinematic", **settings):
        env = make("maze", "raw", simulation=simulation, world="loop", **settings)
        observations, robot_states = [env.reset(seed=0, options={"pose": (3.75, 0.0, 1.57)})[0]], [env.robot_state]
        for action in ACTIONS:
            observations.append(env.step(action)[0])
            robot_states.append(env.robot_state)
        return env, observations, robot_states

    return run_episode


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
def test_a_command_takes_effect_so_many_steps_later(simulation, run):
    *_, late = run(simulation, variation={"latency": 2})
    *_, prompt = run(simulation)
    assert [state.command[0].tolist() for state in late[:3]] == [[0.0, 0.0]] * 3
    for one, other in zip(late[3:], prompt[1:], strict=False):
        np.testing.assert_array_equal(one.command, other.command)
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-3)


@pytest.mark.parametrize(("simulation", "frame_stack"), [("bullet", 1), ("kinematic", 3)])
def test_an_observation_arrives_so_many_steps_later_and_is_rewarded_at_once(simulation, frame_stack, run):
    _, late, late_states = run(simulation, frame_stack=frame_stack, variation={"observation_latency": 2})
    _, prompt, prompt_states = run(simulation, frame_stack=frame_stack)
    np.testing.assert_array_equal(late[:3], prompt[:1] * 3)
    np.testing.assert_array_equal(late[2:], prompt[:-2])
    np.testing.assert_array_equal([each.ranges for each in late_states], [each.ranges for each in prompt_states])
    assert (late[-1] != prompt[-1]).any()


def test_nor_does_it_where_one_of_many_environments_starts_again(start_vec_env):
    variation = {"latency": 2, "observation_latency": 2}
    observe = ["laser", {"last_action": {"count": 2}}]
    env, _ = start_vec_env(Wander(variation=variation, observe=observe, episode_steps=6), num_envs=20)
    for _ in range(6):
        first, _, dones, _ = env.step(np.ones(20, int))
    assert dones.all()
    for _ in range(2):
        observations, *_ = env.step(np.ones(20, int))
        assert (env.loop.robot_state.command == 0.0).all()
        np.testing.assert_array_equal(observations[:, :-4], first[:, :-4])
    assert (first[:, -4:] == 0.0).all()


def test_commands_are_observed_at_once_however_late_the_rest_arrives(run):
    settings = {"observe": ["laser", {"last_action": {"count": 2}}], "frame_stack": 2}
    env, observations, _ = run(variation={"latency": 2, "observation_latency": 2}, **settings)
    commands = np.vstack([np.zeros((2, 2)), env.scene.actions.commands(np.array(ACTIONS))]) / (0.65, np.pi)
    for step, observation in enumerate(observations):
        np.testing.assert_allclose(observation[-4:], np.concatenate([commands[step + 1], commands[step]]), atol=1e-6)
    columns = np.array(env.observation_space.names[: len(observation) // 2]) == "laser"
    _, prompt, _ = run(variation={"latency": 2}, **settings)
    np.testing.assert_array_equal(observations[-1][len(columns) :][columns], prompt[-3][len(columns) :][columns])


def test_the_latency_of_each_environment_is_that_of_its_episode(start_vec_env):
    env, _ = start_vec_env(Wander(variation={"latency": [0, 3]}, collision_range=0.0), num_envs=60)
    latency = env.loop.robot_state.initial_state.records["command_latency"].astype(int)
    assert set(latency) == {0, 1, 2, 3}
    history = [np.zeros((60, 2))] * 3
    for actions in np.random.default_rng(0).integers(3, size=(4, 60)):
        history.append(env.loop.scene.actions.commands(actions))
        env.step(actions)
        expected = np.array(history)[-1 - latency, np.arange(60)]
        np.testing.assert_array_equal(env.loop.robot_state.command, expected)
