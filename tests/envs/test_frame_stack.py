"""The last observations stacked, compared with those of the same episode without stacking."""

import numpy as np
import pytest
import torch as th

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import take_rows
from tb2rl.envs.features import InverseRange
from tb2rl.envs.scene import make_scene
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander

FRAMES, NUM_ENVS = 3, 5
SETTINGS = {"episode_steps": 7, "laser_noise": 0.01}


def joined(observations):
    """Observations of one environment as they are stacked: numbers one after the other, of images the channels."""
    if isinstance(observations[0], dict):
        return {name: joined([each[name] for each in observations]) for name in observations[0]}
    return np.concatenate(observations)


def test_terminal_observations_have_the_true_last_frames(observed, start_vec_env):
    mode, settings = observed
    tasks = (Wander(frame_stack=n, **SETTINGS, **settings) for n in (1, FRAMES))
    (plain_env, first), (env, seen) = (start_vec_env(task, mode, NUM_ENVS) for task in tasks)
    last = [[take_rows(first, i)] * FRAMES for i in range(NUM_ENVS)]
    for _ in range(20):
        np.testing.assert_equal([take_rows(seen, i) for i in range(NUM_ENVS)], [joined(each) for each in last])
        actions = np.arange(NUM_ENVS) % 3
        (plain, _, dones, infos), (seen, _, same, stacked_infos) = (each.step(actions) for each in (plain_env, env))
        np.testing.assert_array_equal(dones, same)
        for i in range(NUM_ENVS):
            if dones[i]:
                final = [*last[i][1:], infos[i]["terminal_observation"]]
                np.testing.assert_equal(stacked_infos[i]["terminal_observation"], joined(final))
                last[i] = [take_rows(plain, i)] * FRAMES
            else:
                last[i] = [*last[i][1:], take_rows(plain, i)]


def test_a_caller_may_write_into_an_observation(observed, start_vec_env):
    last, (mode, settings) = [], observed
    for write in (False, True):
        env, seen = start_vec_env(Wander(frame_stack=2, **SETTINGS, **settings), mode, NUM_ENVS)
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


def test_more_channels_than_an_image_has_rows_are_refused():
    camera = {"camera": {"width": 36, "height": 40}}
    make_scene(Wander(frame_stack=36, observe=(camera,)), "raw")
    with pytest.raises(InputError, match=r"task\.frame_stack=37 makes images of 37 channels, more than their 36"):
        make_scene(Wander(frame_stack=37, observe=("laser", camera)), "raw")
