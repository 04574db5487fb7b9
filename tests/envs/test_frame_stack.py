"""The last observations stacked, compared with those of the same episode without stacking."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.vec_env import VecFrameStack

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import rows
from tb2rl.envs.features import InverseRange
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander
from tb2rl.viz.action_map import action_map

FRAMES, NUM_ENVS = 3, 5
SETTINGS = {"episode_steps": 7, "laser_noise": 0.01}


def joined(observations):
    """Observations of one environment as they are stacked: numbers one after the other, of images the channels."""
    if isinstance(observations[0], dict):
        return {name: joined([each[name] for each in observations]) for name in observations[0]}
    return np.concatenate(observations)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_an_environment_observes_its_last_frames_the_oldest_first(observed, simulation, make):
    task, mode = observed
    plain, stacked = (make(task, mode, simulation=simulation, frame_stack=n, **SETTINGS) for n in (1, FRAMES))
    for seed in (0, 1):
        first = plain.reset(seed=seed)[0]
        seen, last, over = stacked.reset(seed=seed)[0], [first] * FRAMES, False
        while not over:
            np.testing.assert_equal(seen, joined(last))
            assert seen in stacked.observation_space
            latest, reward, _, _, _ = plain.step(1)
            seen, same_reward, terminated, truncated, _ = stacked.step(1)
            last, over = [*last[1:], latest], terminated or truncated
            assert reward == same_reward
        np.testing.assert_equal(seen, joined(last))


def test_terminal_observations_have_the_true_last_frames(observed, start_vec_env):
    task, mode = observed
    (plain_env, first), (env, seen) = (
        start_vec_env(task(frame_stack=n, **SETTINGS), mode, NUM_ENVS) for n in (1, FRAMES)
    )
    last = [[rows(first, i)] * FRAMES for i in range(NUM_ENVS)]
    for _ in range(20):
        np.testing.assert_equal([rows(seen, i) for i in range(NUM_ENVS)], [joined(each) for each in last])
        actions = np.arange(NUM_ENVS) % 3
        (plain, _, dones, infos), (seen, _, same, stacked_infos) = (each.step(actions) for each in (plain_env, env))
        np.testing.assert_array_equal(dones, same)
        for i in range(NUM_ENVS):
            if dones[i]:
                final = [*last[i][1:], infos[i]["terminal_observation"]]
                np.testing.assert_equal(stacked_infos[i]["terminal_observation"], joined(final))
                last[i] = [rows(plain, i)] * FRAMES
            else:
                last[i] = [*last[i][1:], rows(plain, i)]


def test_images_are_stacked_where_stable_baselines3_stacks_them(image_task):
    scenes = [make_scene(image_task(episode_steps=7, frame_stack=n), "raw") for n in (1, FRAMES)]
    env = TurtleBot2VecEnv(scenes[1], NUM_ENVS)
    theirs = VecFrameStack(TurtleBot2VecEnv(scenes[0], NUM_ENVS), FRAMES)
    assert env.observation_space == theirs.observation_space
    for one in (env, theirs):
        one.seed(1)
        one.reset()
    for _ in range(FRAMES):  # from then on zeros are no longer among theirs
        seen, same = (one.step(np.ones(NUM_ENVS, int))[0] for one in (env, theirs))
    np.testing.assert_equal(seen, same)


def test_a_caller_may_write_into_an_observation(observed, start_vec_env):
    last = []
    for write in (False, True):
        env, seen = start_vec_env(observed[0](frame_stack=2, **SETTINGS), observed[1], NUM_ENVS)
        for _ in range(12):
            for part in (seen.values() if isinstance(seen, dict) else [seen]) if write else []:
                part[...] = 0
            seen = env.step(np.ones(NUM_ENVS, int))[0]
        last.append(seen)
    np.testing.assert_equal(*last)


def test_names_and_units_are_repeated_so_that_inverse_range_knows_metres():
    plain, space = (make_scene(ReachGoal(frame_stack=n, beams=5), "raw").observation_space for n in (1, 2))
    assert space.names == plain.names * 2 == (("laser",) * 5 + ("goal distance", "goal bearing")) * 2
    assert space.units == (("m",) * 6 + ("rad",)) * 2
    assert (space.shape, space.frame_stack) == ((14,), 2)
    observation = plain.sample()
    both = InverseRange(space)(th.as_tensor(np.tile(observation, 2)))
    assert th.equal(both, InverseRange(plain)(th.as_tensor(observation)).repeat(2))


def test_more_channels_than_an_image_has_rows_are_refused(image_task):
    assert make_scene(image_task(frame_stack=36), "raw").observation_space is not None
    with pytest.raises(InputError, match=r"task\.frame_stack=37 makes images of 37 channels, more than their 36"):
        make_scene(image_task(frame_stack=37), "raw")


def test_an_action_map_is_drawn_of_a_policy_with_frames():
    scene = make_scene(Wander(frame_stack=2), "raw")

    class Nearest:
        policy = None

        def predict(self, observations, deterministic):
            assert observations.shape[1:] == scene.observation_space.shape
            np.testing.assert_array_equal(observations[:, :36], observations[:, 36:])
            return np.zeros(len(observations), int), None

    assert action_map(Nearest(), scene).actions.max() == 0
