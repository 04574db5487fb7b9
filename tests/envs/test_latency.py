"""Commands that are obeyed late and readings that are observed late, in every face of an environment."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import task_names
from tb2rl.envs.observation_delay import Delay
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.simulation.variation import PRESETS
from tb2rl.tasks.wander import Wander

STRONG = {"preset": "strong", "latency": [1, 3], "observation_latency": [0, 2]}


def make(simulation="kinematic", observation="raw", **settings):
    return tb2rl.make_env("maze", observation, simulation=simulation, world="loop", **settings)


def drive(env, actions, seed=0):
    """The observations and the readings of an episode, the first ones too."""
    observations, readings = [env.reset(seed=seed, options={"pose": (3.75, 0.0, 1.57)})[0]], [env.robot_state]
    for action in actions:
        observations.append(env.step(action)[0])
        readings.append(env.robot_state)
    return observations, readings


# ---- one robot


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_command_is_obeyed_so_many_steps_later(simulation):
    actions = [1, 0, 2, 0, 1, 1, 0]
    _, late = drive(make(simulation, variation={"latency": 2}), actions)
    _, told = drive(make(simulation), actions)
    assert [r.command[0].tolist() for r in late[:3]] == [[0.0, 0.0]] * 3
    for lagging, prompt in zip(late[3:], told[1:], strict=False):
        np.testing.assert_array_equal(lagging.command, prompt.command)
        np.testing.assert_allclose(lagging.pose, prompt.pose, atol=1e-3)


@pytest.mark.parametrize("frame_stack", [1, 3])
@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_reading_is_observed_so_many_steps_later_and_judged_at_once(simulation, frame_stack):
    actions = [1, 0, 2, 0, 1, 1, 0]
    late, readings = drive(make(simulation, frame_stack=frame_stack, variation={"observation_latency": 2}), actions)
    prompt, told = drive(make(simulation, frame_stack=frame_stack), actions)
    for one, other in zip(late[:3], prompt[:1] * 3, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(late[2:], prompt, strict=False):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(readings, told, strict=True):
        np.testing.assert_array_equal(one.ranges, other.ranges)
    assert (late[-1] != prompt[-1]).any()


def test_nothing_of_an_episode_arrives_in_the_next_one():
    env = make(variation={"latency": 3, "observation_latency": 3})
    drive(env, [1] * 5)
    first = env.reset(seed=1)[0]
    seen = [env.step(1)[0] for _ in range(3)]
    assert all((one == first).all() for one in seen)
    assert (env.robot_state.command == 0.0).all()


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_what_was_told_is_known_at_once_however_late_the_rest_comes(simulation):
    observe, actions = ["laser", {"last_action": {"count": 2}}], [1, 0, 2, 0]
    env = make(simulation, observe=observe, frame_stack=2, variation={"latency": 2, "observation_latency": 2})
    observations, _ = drive(env, actions)
    told = np.vstack([np.zeros((2, 2)), env.scene.actions.commands(np.array(actions))]) / (0.65, np.pi)
    for step, observation in enumerate(observations):
        np.testing.assert_allclose(observation[-4:], np.concatenate([told[step + 1], told[step]]), atol=1e-6)
    columns = np.array(env.observation_space.names[: len(observation) // 2]) == "laser"
    prompt, _ = drive(make(simulation, observe=observe, frame_stack=2, variation={"latency": 2}), actions)
    np.testing.assert_array_equal(observations[-1][len(columns) :][columns], prompt[-3][len(columns) :][columns])


# ---- thousands


def rollout(variation, num_envs, steps=60, **settings):
    env = TurtleBot2VecEnv(make_scene(Wander(variation=variation, episode_steps=25, **settings), "raw"), num_envs)
    env.seed(4)
    env.reset()
    rng = np.random.default_rng(0)
    actions = rng.integers(3, size=(steps, 200))[:, :num_envs]
    return env, [env.step(chosen) for chosen in actions]


def test_each_robot_of_a_batch_is_as_late_as_its_own_episode_says():
    env = TurtleBot2VecEnv(make_scene(Wander(variation={"latency": [0, 3]}, episode_steps=1500), "raw"), 60)
    env.seed(0)
    env.reset()
    late = env.loop.robot_state.initial_state.command_latency.astype(int)
    assert set(late) == {0, 1, 2, 3}
    table, history = env.loop.scene.actions, []
    for step in range(4):
        actions = np.random.default_rng(step).integers(3, size=60)
        history.append(table.commands(actions))
        _, _, dones, _ = env.step(actions)
        begun = ~dones
        obeyed = env.loop.robot_state.command
        for robot in np.flatnonzero(begun):
            if (then := step - late[robot]) >= 0:
                np.testing.assert_array_equal(obeyed[robot], history[then][robot])
            else:
                assert (obeyed[robot] == 0.0).all()
        if dones.any():
            break


def test_nothing_of_an_episode_arrives_in_the_next_one_of_a_batch():
    settings = {
        "variation": {"latency": 2, "observation_latency": 2},
        "observe": ["laser", {"last_action": {"count": 2}}],
    }
    env = TurtleBot2VecEnv(make_scene(Wander(**settings, episode_steps=6), "raw"), 20)
    env.seed(0)
    env.reset()
    for _ in range(6):
        first, _, dones, _ = env.step(np.ones(20, int))
    assert dones.any()
    begun = np.flatnonzero(dones)
    for _ in range(2):
        observations, *_ = env.step(np.ones(20, int))
        assert (env.loop.robot_state.command[begun] == 0.0).all()
        np.testing.assert_array_equal(observations[begun, :-4], first[begun, :-4])
    assert (first[begun, -4:] == 0.0).all()


def test_a_robot_meets_the_same_whatever_the_others_do():
    _, many = rollout(STRONG, 200)
    _, few = rollout(STRONG, 10)
    for one, other in zip(many, few, strict=True):
        np.testing.assert_array_equal(one[0][:10], other[0])
        np.testing.assert_array_equal(one[1][:10], other[1])


def test_variation_moves_no_start_pose():
    starts = []
    for variation in ("none", "strong"):
        env = TurtleBot2VecEnv(make_scene(Wander(variation=variation), "raw"), 30)
        env.seed(0)
        env.reset()
        starts.append(env.loop.robot_state.pose)
    np.testing.assert_array_equal(*starts)


@pytest.mark.parametrize("observe", [None, ["laser", {"last_action": {"count": 5}}]])
def test_a_batch_goes_on_from_a_state_to_the_bit(observe):
    env, _ = rollout(STRONG, 40, frame_stack=2, laser_noise=0.01, observe=observe)
    state = copy.deepcopy(env.state())
    chosen = np.random.default_rng(9).integers(3, size=(40, 40))
    expected = [env.step(actions) for actions in chosen]
    other, _ = rollout(STRONG, 40, steps=3, frame_stack=2, laser_noise=0.01, observe=observe)
    other.restore(state)
    for actions, answer in zip(chosen, expected, strict=True):
        np.testing.assert_equal(other.step(actions), answer)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_an_environment_goes_on_from_a_state_and_as_a_copy_to_the_bit(simulation):
    env = make(simulation, frame_stack=2, variation=STRONG)
    env.reset(seed=3)
    for _ in range(4):
        env.step(1)
    state, copied = copy.deepcopy(env.state()), copy.deepcopy(env)
    other = make(simulation, frame_stack=2, variation=STRONG)
    other.restore(state)
    expected = [env.step(action)[0] for action in (0, 1, 2, 1)]
    for each in (copied, other):
        for action, seen in zip((0, 1, 2, 1), expected, strict=True):
            np.testing.assert_array_equal(each.step(action)[0], seen)
        each.close()


# ---- images and other mappings


def test_a_mapping_is_delayed_in_all_its_parts():
    delay = Delay(1)
    delay.begin({"a": np.zeros((2, 3)), "b": np.zeros((2, 1))})
    latest = {"a": np.ones((2, 3)), "b": np.ones((2, 1))}
    arriving = delay.push(latest, np.array([1.0, 0.0]))
    assert arriving["a"].tolist() == [[0] * 3, [1] * 3]
    assert arriving["b"].tolist() == [[0], [1]]
    arriving["a"][:] = 7  # whoever gets it may write into it
    assert delay.push(latest, np.array([1.0, 1.0]))["a"].tolist() == [[1] * 3] * 2


# ---- every task, every way to say it


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("name", task_names())
def test_every_task_can_be_varied(name, simulation):
    with tb2rl.make_env(name, simulation=simulation, variation="strong") as env:
        env.reset(seed=0)
        assert (env.robot_state.initial_state.parameters != env.scene.robot.parameters).any()
        for _ in range(3):
            assert env.observation_space.contains(env.step(env.action_space.sample())[0])


def test_what_does_not_fit_is_said_when_it_is_made():
    for setting in ("wild", {"latency": -1}, {"nothing": 1}, 3, ["mild"], None):
        with pytest.raises(InputError, match=r"task\.variation") as caught:
            make(variation=setting)
        assert "\n" not in str(caught.value)


def test_a_preset_can_be_changed_in_one_thing():
    task = make(variation={"preset": "mild", "latency": [0, 1]}).task
    assert task.resolved_variation == PRESETS["mild"]
