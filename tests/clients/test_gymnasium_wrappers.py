"""Gymnasium's checker and wrappers of single environments."""

import av
import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env

import tb2rl

MAZE, RAW, DRIVE = "tb2rl:TurtleBot2Maze-v0", "tb2rl:TurtleBot2MazeRaw-v0", "tb2rl:TurtleBot2DriveRaw-v0"
CHECKED = [(name, "bullet" if name.startswith("TurtleBot2Maze") else "kinematic") for name in tb2rl.GYM_IDS]


@pytest.fixture
def make():
    """`gymnasium.make`, in the kinematic simulator by default; environments are closed after the test."""
    made = []

    def make_env(env_id=RAW, simulation="kinematic", **settings):
        made.append(gym.make(env_id, simulation=simulation, **settings))
        return made[-1]

    yield make_env
    for env in made:
        env.close()


@pytest.mark.parametrize(("name", "simulation"), CHECKED)
def test_the_checker_finds_nothing(name, simulation, make):
    """Doubts of the checker are warnings, which are errors here."""
    check_env(make(name, simulation).unwrapped)


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


def test_frames_are_stacked_and_not_overwritten(make):
    env, plain = wrappers.FrameStackObservation(make(), 3), make()
    first = plain.reset(seed=2)[0]
    np.testing.assert_array_equal(env.reset(seed=2)[0], [first] * 3)
    frames = [plain.step(1)[0].copy() for _ in range(3)]
    stacked = [env.step(1)[0] for _ in range(3)][-1]
    np.testing.assert_array_equal(stacked, frames)
    assert not np.array_equal(frames[0], frames[2])


@pytest.mark.parametrize(
    ("env_id", "wrapper"),
    [
        (MAZE, wrappers.FlattenObservation),
        (RAW, wrappers.TimeAwareObservation),
        (DRIVE, lambda env: wrappers.RescaleAction(env, np.float32(0.0), np.float32(1.0))),
    ],
)
def test_a_wrapped_environment_keeps_to_its_spaces(env_id, wrapper, make):
    env = wrapper(make(env_id, max_episode_steps=20))
    env.action_space.seed(0)
    (observation, _), ended = env.reset(seed=0), False
    while not ended:
        assert env.observation_space.contains(observation)
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert np.isfinite(float(reward))
        ended = terminated or truncated
