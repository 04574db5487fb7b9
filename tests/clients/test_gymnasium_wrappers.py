"""Gymnasium's own tools and wrappers around one environment."""

import os
from dataclasses import dataclass

import av
import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces, wrappers
from gymnasium.utils.env_checker import check_env

import tb2rl
from tb2rl.tasks import Outcome, Task, Velocities

RAW = "tb2rl:TurtleBot2MazeRaw-v0"


@pytest.fixture(params=("bullet", "kinematic"))
def make(request):
    """`gymnasium.make` in either simulation; closed after the test."""
    made = []

    def make_env(env_id=RAW, **settings):
        made.append(gym.make(env_id, simulation=request.param, **settings))
        return made[-1]

    yield make_env
    for env in made:
        env.close()


@pytest.mark.parametrize("name", tb2rl.GYM_IDS)
def test_the_checker_finds_nothing(name, make):
    """It warns of what it only doubts, and a warning is an error here."""
    env = make(name).unwrapped
    window_without_display = "human" in env.metadata["render_modes"] and "DISPLAY" not in os.environ
    check_env(env, skip_render_check=window_without_display)


def test_an_episode_is_filmed(make, tmp_path):
    pytest.importorskip("moviepy", reason="moviepy is not installed (gymnasium[other])")
    env = wrappers.RecordVideo(
        make(render_mode="rgb_array", max_episode_steps=7), str(tmp_path / "films"), disable_logger=True
    )
    env.reset(seed=1)
    ended, steps = False, 0
    while not ended:
        *_, terminated, truncated, _ = env.step(1)
        ended, steps = terminated or truncated, steps + 1
    env.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    with av.open(film) as container:
        assert len(list(container.decode(video=0))) == steps + 1


def test_a_wrapped_time_limit_truncates(make):
    env = wrappers.TimeLimit(make(), 4)
    env.reset(seed=1)
    assert [env.step(1)[3] for _ in range(4)] == [False, False, False, True]


def test_frames_are_stacked_and_not_overwritten(make):
    env, plain = wrappers.FrameStackObservation(make(), 3), make()
    first = plain.reset(seed=2)[0]
    np.testing.assert_array_equal(env.reset(seed=2)[0], [first] * 3)
    frames = [plain.step(1)[0].copy() for _ in range(3)]
    stacked = [env.step(1)[0] for _ in range(3)][-1]
    assert env.observation_space.contains(stacked)
    np.testing.assert_array_equal(stacked, frames)
    assert not np.array_equal(frames[0], frames[2])


@pytest.mark.parametrize(
    ("env_id", "wrapper"),
    [
        ("tb2rl:TurtleBot2Maze-v0", wrappers.FlattenObservation),
        (RAW, wrappers.NormalizeObservation),
        (RAW, lambda env: wrappers.RescaleObservation(env, np.float32(0.0), np.float32(1.0))),
        (RAW, wrappers.TimeAwareObservation),
        (RAW, lambda env: wrappers.StickyAction(env, 0.3)),
        (RAW, lambda env: wrappers.TransformAction(env, lambda left: 3 - left, spaces.Discrete(3, start=1))),
        (RAW, wrappers.Autoreset),
    ],
)
def test_a_wrapped_environment_gives_what_its_space_says(env_id, wrapper, make):
    env = wrapper(make(env_id, max_episode_steps=20))
    env.action_space.seed(0)
    seen, _ = env.reset(seed=0)
    for _ in range(20):
        assert env.observation_space.contains(np.asarray(seen) if not isinstance(seen, dict) else seen)
        seen, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert np.isfinite(float(reward))
        if terminated or truncated:
            break


@dataclass(frozen=True)
class Glide(Task):
    """Wander at any speed."""

    actions = Velocities(forward=(0.0, 0.5), turn=(-2.0, 2.0))

    def outcome(self, before, action, after):
        return Outcome(after.twist[:, 0], failed={"collision": after.bumped})


@pytest.mark.parametrize("simulation", ("bullet", "kinematic"))
def test_speeds_are_rescaled(simulation):
    env, plain = (tb2rl.make_env(Glide, "raw", simulation=simulation) for _ in range(2))
    rescaled = wrappers.RescaleAction(env, np.float32(0.0), np.float32(1.0))
    poses = []
    for one, action in ((rescaled, [1.0, 0.25]), (plain, [1.0, -0.5])):
        one.reset(seed=0)
        poses.append([one.step(np.float32(action))[-1]["pose"] for _ in range(5)])
        one.close()
    np.testing.assert_array_equal(*poses)
    assert rescaled.action_space == spaces.Box(0.0, 1.0, (2,), np.float32)
