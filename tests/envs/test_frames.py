"""The last observations stacked: held against those of the same drive without frames, in every face."""

from __future__ import annotations

import copy
from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FrameStackObservation
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3
from stable_baselines3.common.vec_env import VecFrameStack

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import rows
from tb2rl.envs.features import InverseRange
from tb2rl.envs.observation_pipeline import stacked_space
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.envs.vector_env import TurtleBot2VectorEnv
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander
from tb2rl.viz.action_map import action_map

FRAMES, ROBOTS = 3, 5
SETTINGS = {"episode_steps": 7, "laser_noise": 0.01}


def joined(observations):
    """Observations of one robot as they are stacked: numbers one after the other, of images the channels."""
    if isinstance(observations[0], dict):
        return {name: joined([each[name] for each in observations]) for name in observations[0]}
    return np.concatenate(observations)


def alike(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[name], other[name]) for name in one)
    return one.dtype == other.dtype and np.array_equal(one, other)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_an_environment_observes_its_last_frames_the_oldest_first(observed, simulation, make):
    plain, stacked = (
        make(observed[0], observed[1], simulation=simulation, frame_stack=n, **SETTINGS) for n in (1, FRAMES)
    )
    for seed in (0, 1):
        first = plain.reset(seed=seed)[0]
        seen, last = stacked.reset(seed=seed)[0], [first] * FRAMES
        over = False
        while not over:
            assert alike(seen, joined(last))
            assert seen in stacked.observation_space
            latest, reward, _, _, _ = plain.step(1)
            seen, same_reward, terminated, truncated, _ = stacked.step(1)
            last, over = [*last[1:], latest], terminated or truncated
            assert reward == same_reward
        assert alike(seen, joined(last))


def test_a_batch_does_so_for_every_robot_and_its_terminal_observations_have_the_true_last_frames(observed):
    task, mode = observed
    envs = [TurtleBot2VecEnv(make_scene(task(frame_stack=n, **SETTINGS), mode), ROBOTS) for n in (1, FRAMES)]
    for env in envs:
        env.seed(4)
    first, seen = (env.reset() for env in envs)
    last = [[rows(first, robot)] * FRAMES for robot in range(ROBOTS)]
    for _ in range(20):
        assert all(alike(rows(seen, robot), joined(last[robot])) for robot in range(ROBOTS))
        actions = np.arange(ROBOTS) % 3
        (plain, _, dones, infos), (seen, _, same, stacked_infos) = (env.step(actions) for env in envs)
        np.testing.assert_array_equal(dones, same)
        for robot in range(ROBOTS):
            if dones[robot]:
                final = [*last[robot][1:], infos[robot]["terminal_observation"]]
                assert alike(stacked_infos[robot]["terminal_observation"], joined(final))
                last[robot] = [rows(plain, robot)] * FRAMES
            else:
                last[robot] = [*last[robot][1:], rows(plain, robot)]


def test_both_faces_of_a_batch_are_alike(observed):
    scene = make_scene(observed[0](frame_stack=FRAMES, **SETTINGS), observed[1])
    one, other = TurtleBot2VecEnv(scene, ROBOTS), TurtleBot2VectorEnv(scene, ROBOTS)
    one.seed(4)
    pairs = [(one.reset(), other.reset(seed=4)[0])]
    pairs += [(one.step(np.ones(ROBOTS, int))[0], other.step(np.ones(ROBOTS, int))[0]) for _ in range(10)]
    assert all(alike(mine, its) for mine, its in pairs)
    assert pairs[-1][1] in other.observation_space


def test_they_are_those_of_gymnasiums_wrapper(make):
    ours = make("maze", "raw", simulation="kinematic", frame_stack=4)
    theirs = FrameStackObservation(make("maze", "raw", simulation="kinematic"), 4)
    np.testing.assert_array_equal(ours.reset(seed=1)[0], theirs.reset(seed=1)[0].ravel())
    for action in (0, 1, 2, 0, 0, 1):
        np.testing.assert_array_equal(ours.step(action)[0], theirs.step(action)[0].ravel())


def test_images_are_stacked_where_stable_baselines3_stacks_them(image_task):
    scene = make_scene(image_task(episode_steps=7), "raw")
    env = TurtleBot2VecEnv(make_scene(image_task(episode_steps=7, frame_stack=FRAMES), "raw"), ROBOTS)
    theirs = VecFrameStack(TurtleBot2VecEnv(scene, ROBOTS), FRAMES)
    assert env.observation_space == theirs.observation_space
    for one in (env, theirs):
        one.seed(1)
        one.reset()
    for _ in range(FRAMES):  # from then on zeros are no longer among theirs
        seen, same = (one.step(np.ones(ROBOTS, int))[0] for one in (env, theirs))
    assert alike(seen, same)


def test_whoever_gets_an_observation_may_write_into_it(image_task):
    for task in (Wander, image_task):
        env = TurtleBot2VecEnv(make_scene(task(frame_stack=2, **SETTINGS), "raw"), ROBOTS)
        ways = []
        for spoil in (False, True):
            env.seed(0)
            seen = env.reset()
            for _ in range(12):
                for part in (seen.values() if isinstance(seen, dict) else [seen]) if spoil else []:
                    part[...] = 0
                seen = env.step(np.ones(ROBOTS, int))[0]
            ways.append(seen)
        assert alike(*ways)


def test_names_and_units_are_repeated_so_that_nearness_knows_metres():
    space = make_scene(ReachGoal(frame_stack=2, beams=5), "raw").observation_space
    assert space.names == ("laser",) * 5 + ("goal distance", "goal bearing") + ("laser",) * 5 + (
        "goal distance",
        "goal bearing",
    )
    assert space.units == (("m",) * 6 + ("rad",)) * 2
    assert (space.shape, space.frame_stack) == ((14,), 2)
    observation = make_scene(ReachGoal(beams=5), "raw").observation_space.sample()
    alone = InverseRange(make_scene(ReachGoal(beams=5), "raw").observation_space)(th.as_tensor(observation))
    both = InverseRange(space)(th.as_tensor(np.tile(observation, 2)))
    assert th.equal(both, alone.repeat(2))


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_the_state_of_an_environment_has_its_frames(observed, simulation, make):
    env = make(observed[0], observed[1], simulation=simulation, frame_stack=FRAMES, laser_noise=0.01)
    env.reset(seed=0)
    env.step(1)
    state = copy.deepcopy(env.state())
    other = make(observed[0], observed[1], simulation=simulation, frame_stack=FRAMES, laser_noise=0.01)
    other.restore(state)
    ways = [[one.step(2)[0] for _ in range(4)] for one in (env, copy.deepcopy(env), other)]
    assert all(alike(mine, its) for way in ways[1:] for mine, its in zip(ways[0], way, strict=True))


def test_frames_that_are_no_observations_are_refused(make):
    env = make("maze", "discrete", simulation="kinematic", frame_stack=2)
    env.reset(seed=0)
    state = env.state()
    state["frame_stack"]["stack"][0, 3] = 99
    with pytest.raises(ValueError, match="outside the observation space"):
        env.restore(state)


@pytest.mark.parametrize("mode", ["discrete", "raw"])
def test_gymnasiums_makers_take_frames(mode):
    with closing(gym.make("tb2rl:TurtleBot2Maze-v0", observation=mode, simulation="kinematic", frame_stack=4)) as env:
        shape = env.observation_space.shape
        assert env.reset(seed=0)[0].shape == shape == (4 * {"discrete": 7, "raw": 36}[mode],)
        check_env(env.unwrapped, skip_render_check=True)
        check_env_for_sb3(env.unwrapped)
    for simulation in ("bullet", "kinematic"):
        arguments = {"num_envs": 2, "observation": mode, "simulation": simulation, "frame_stack": 4}
        with closing(gym.make_vec("tb2rl:TurtleBot2Maze-v0", **arguments)) as envs:
            assert envs.reset(seed=0)[0].shape == (2, *shape)
            assert envs.step(np.zeros(2, int))[0] in envs.observation_space


def test_stacked_images_keep_the_contracts(image_task, make):
    env = make(image_task, "raw", simulation="kinematic", frame_stack=FRAMES)
    check_env(env, skip_render_check=True)
    check_env_for_sb3(env)


def test_more_channels_than_an_image_has_rows_are_refused(image_task):
    assert make_scene(image_task(frame_stack=36), "raw").observation_space is not None
    with pytest.raises(InputError, match=r"task\.frame_stack=37 makes images of 37 channels, more than their 36"):
        make_scene(image_task(frame_stack=37), "raw")


def test_without_frames_a_space_is_the_one_that_it_was():
    space = make_scene(Wander(), "raw").observation_space
    assert stacked_space(space, 1) is space


def test_a_map_of_actions_is_drawn_of_a_policy_with_frames():
    scene = make_scene(Wander(frame_stack=2), "raw")

    class Nearest:
        policy = None

        def predict(self, observations, deterministic):
            assert observations.shape[1:] == scene.observation_space.shape
            np.testing.assert_array_equal(observations[:, :36], observations[:, 36:])
            return np.zeros(len(observations), int), None

    assert action_map(Nearest(), scene).actions.max() == 0
