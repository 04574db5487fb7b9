"""The environments: what Gymnasium and Stable-Baselines3 ask of them, the same trajectory from one seed, pictures."""

import os
import subprocess
import sys
from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import tb2rl
from tb2rl.envs import TurtleBot2Env, make_env
from tb2rl.errors import InputError
from tb2rl.maze import maze_names
from tb2rl.observations import OBSERVATIONS
from tb2rl.tasks.wander import Wander

FORWARD, LEFT, RIGHT = Wander.FORWARD, Wander.LEFT, Wander.RIGHT
CORNER = (-3.75, -3.75, 0.0)  # a free pose of the maze "loop"


def world(*arguments, **settings):
    return closing(TurtleBot2Env(*arguments, **settings))


def drive(env, actions):
    """The answers of `step` to some actions, as far as the episode goes."""
    answers = []
    for action in actions:
        answers.append(env.step(action))
        if answers[-1][2] or answers[-1][3]:
            break
    return answers


# ---- contracts


@pytest.mark.parametrize("observation", OBSERVATIONS)
@pytest.mark.parametrize("name", tb2rl.GYM_IDS)
def test_every_id_keeps_the_contracts_of_gymnasium_and_stable_baselines3(name, observation):
    env = gym.make(f"tb2rl:{name}", observation=observation, render_mode="rgb_array").unwrapped
    check_env(env, skip_render_check=True)  # it would open the window of "human"
    check_env_for_sb3(env)
    env.close()


@pytest.mark.parametrize("maze", maze_names())
def test_gymnasium_makes_it_in_any_maze(maze):
    env = gym.make("tb2rl:TurtleBot2Maze-v0", maze=maze, observation="raw")
    seen, info = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert env.unwrapped.maze.clearance(*info["pose"][:2]) >= 0.6 - 1e-3
    env.close()


SCRIPT = """
import hashlib
import gymnasium
import tb2rl
for name in tb2rl.GYM_IDS:
    env = gymnasium.make(name, observation="raw", noise=0.01)
    env.action_space.seed(5)
    seen, info = env.reset(seed=4)
    digest = hashlib.sha256(seen.tobytes() + info["pose"].tobytes())
    episodes = 0
    for _ in range(300):
        seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
        digest.update(seen.tobytes() + info["pose"].tobytes() + repr(reward).encode())
        if terminated or truncated:
            episodes += 1
            digest.update(env.reset()[0].tobytes())
    print(digest.hexdigest(), episodes)
"""


def test_the_same_seed_and_actions_give_the_same_trajectory_to_the_bit_in_another_process():
    outputs = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    ]
    assert outputs[0] == outputs[1]
    assert len(set(outputs[0].split("\n"))) == len(tb2rl.GYM_IDS) + 1  # each has its own


def test_the_same_seed_gives_the_same_episode_again_and_another_seed_another():
    with world(noise=0.01, observation="raw") as env:
        episodes = []
        for seed in (3, 3, 4):
            first, _ = env.reset(seed=seed)
            episodes.append(np.stack([first, *(answer[0] for answer in drive(env, [LEFT, FORWARD, RIGHT] * 3))]))
    assert (episodes[0] == episodes[1]).all()
    assert (episodes[0] != episodes[2]).any()


def test_without_a_seed_every_episode_starts_elsewhere():
    with world() as env:
        assert len({tuple(env.reset(seed=0 if i == 0 else None)[1]["pose"]) for i in range(5)}) == 5


# ---- starts


def test_a_fixed_start_is_the_one_of_the_maze():
    with world(start="fixed") as env:
        assert env.reset()[1]["pose"] == pytest.approx(CORNER)
        assert env.reset()[1]["pose"] == pytest.approx(CORNER)


@pytest.mark.parametrize("pose", [(3.75, 0.0, 1.5), [3.75, 0, -3], np.array([3.75, 0.0, 0.5])])
def test_an_option_says_where_to_start(pose):
    with world() as env:
        assert env.reset(options={"pose": pose})[1]["pose"] == pytest.approx(np.array(pose))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pose": (0, 0, 0)}, "inside a wall of maze loop"),
        ({"pose": (-4.9, 0, 0)}, "inside a wall of maze loop"),  # its middle is not, but its side is
        ({"pose": (100, 100, 0)}, "maze loop"),
        ({"pose": (0, 0)}, "options.pose"),
        ({"pose": (np.nan, 0, 0)}, "finite"),
        ({"pose": "here"}, "'here'"),
    ],
)
def test_a_start_that_cannot_be_is_refused(options, words):
    with world() as env, pytest.raises(InputError, match=words):
        env.reset(options=options)


def test_a_maze_too_narrow_for_the_starts_clearance_is_refused():
    with pytest.raises(InputError, match="no free space"):
        TurtleBot2Env(start_clearance=2.0)


# ---- steps


def test_a_step_reports_where_the_robot_is_and_how_it_fares():
    with world("maze", "raw", start="fixed") as env:
        _, info = env.reset()
        assert (info["distance"], info["bumped"], info["is_success"], info["ended"]) == (0, False, False, None)
        assert info["min_range"] == pytest.approx(1.25)
        answers = drive(env, [FORWARD] * 10)
        seen, reward, terminated, truncated, info = answers[-1]
    assert (reward, terminated, truncated) == (5, False, False)
    assert info["pose"] == pytest.approx([CORNER[0] + info["distance"], CORNER[1], 0], abs=0.01)
    assert info["distance"] == pytest.approx(1.0, abs=0.05)  # 10 steps of 0.2 s at 0.5 m/s, from rest
    assert info["min_range"] == pytest.approx(seen.min())


def test_a_crash_terminates_and_is_no_success():
    with world() as env:
        env.reset(options={"pose": CORNER[:2] + (-np.pi / 2,)})
        *before, (_, reward, terminated, truncated, info) = drive(env, [FORWARD] * 30)
    assert before
    assert {answer[4]["ended"] for answer in before} == {None}
    assert (reward, terminated, truncated) == (-200, True, False)
    assert (info["ended"], info["is_success"], info["bumped"]) == ("crash", False, False)
    assert info["min_range"] < 0.5


def test_with_a_crash_range_of_0_only_the_bumper_ends_the_episode():
    with world(crash_range=0.0) as env:
        env.reset(options={"pose": CORNER[:2] + (-np.pi / 2,)})
        *_, info = drive(env, [FORWARD] * 30)[-1]
    assert (info["ended"], info["bumped"]) == ("crash", True)
    assert info["min_range"] == pytest.approx(0.178, abs=0.01)


def test_the_time_limit_truncates_and_is_a_success_of_wandering():
    with world(episode_steps=3) as env:
        env.reset(seed=0)
        *before, (_, reward, terminated, truncated, info) = drive(env, [LEFT] * 9)
    assert [answer[4]["ended"] for answer in before] == [None, None]
    assert (reward, terminated, truncated) == (1, False, True)
    assert (info["ended"], info["is_success"]) == ("time limit", True)


def test_reaching_the_goal_is_a_success_and_running_out_of_time_is_not():
    with world("wall", episode_steps=3) as env:
        env.reset(options={"pose": (4.6, 0, 0)})
        _, reward, terminated, _, info = drive(env, [FORWARD] * 3)[-1]
        assert (reward, terminated, info["ended"], info["is_success"]) == (200, True, "goal", True)
        env.reset(options={"pose": (0, 2, 0)})
        *_, truncated, info = drive(env, [FORWARD] * 3)[-1]
        assert (truncated, info["ended"], info["is_success"]) == (True, "time limit", False)


@pytest.mark.parametrize("action", [0, np.int64(0), np.int32(0), np.array(0)])
def test_any_integer_is_an_action(action):
    with world() as env:
        env.reset(seed=0)
        assert env.step(action)[1] == 5


@pytest.mark.parametrize("action", [3, -1, 10**30, np.nan, 0.0, np.float32(1), "0", None, [0], np.array([0])])
def test_what_is_no_action_is_refused(action):
    with world() as env:
        env.reset(seed=0)
        with pytest.raises(InputError, match="none of the integers 0 to 2"):
            env.step(action)


def test_a_step_before_the_reset_is_refused():
    with world() as env, pytest.raises(InputError, match="reset first"):
        env.step(0)


# ---- pictures


def pixel(env, picture, x, y):
    """The colour at a place [m]; the picture shows the maze's bounds and 0.3 m around them."""
    x0, y0, x1, y1 = env.maze.bounds
    height, width, _ = picture.shape
    column = (x - x0 + 0.3) / (x1 - x0 + 0.6) * width
    row = (y1 + 0.3 - y) / (y1 - y0 + 0.6) * height
    return picture[int(row), int(column)].astype(int)


def test_a_picture_shows_the_walls_and_the_robot_where_it_is():
    with world(render_mode="rgb_array", start="fixed", beams=1) as env:
        assert env.render() is None  # nothing to show yet
        env.reset()
        before = env.render()
        assert before.dtype == np.uint8
        assert before.ndim == 3
        drive(env, [FORWARD] * 10)
        after = env.render()
        tail = CORNER[0] - 0.12, CORNER[1]  # behind the middle of the body, off its wheels and its nose
        now = env.path[-1][0] - 0.12, env.path[-1][1]
        assert pixel(env, before, *tail).max() < 80
        assert pixel(env, after, *now).max() < 80
        assert pixel(env, after, *tail).min() > 200  # floor again
        assert pixel(env, before, *now).max() > 200
        red, green, blue = pixel(env, before, 1.25, 1.25)
        assert red > green + 40 > blue + 40
        assert (before != after).any()


def test_without_a_render_mode_there_is_no_picture():
    with world() as env:
        env.reset(seed=0)
        assert env.render() is None


def test_an_unknown_render_mode_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="unknown render_mode 'ansi'; known: None, 'rgb_array', 'human'"):
        TurtleBot2Env(render_mode="ansi")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there a display is an environment variable")
def test_a_window_without_a_display_is_refused_with_the_way_out(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(InputError, match="no display; use 'rgb_array'"):
        TurtleBot2Env(render_mode="human")


# ---- making one


def test_settings_of_the_task_are_arguments():
    with closing(make_env("my-maze", "raw", maze="circuit", beams=9, noise=0.01)) as env:
        assert env.task.maze == env.maze.name == "circuit"
        assert (env.observation_space.shape, env.action_space.n, env.laser.noise) == ((9,), 4, 0.01)


def test_a_task_itself_is_an_argument_and_may_be_overridden():
    task = Wander(maze="circuit", crash_range=0.4)
    with closing(make_env(task, "raw", crash_range=0.3, beams=9)) as env:
        assert (env.maze.name, env.task.crash_range, env.observation_space.shape) == ("circuit", 0.3, (9,))
    with world(task) as env:
        assert env.task == task
    with world(task, maze="round") as env:
        assert (env.maze.name, env.task.crash_range) == ("round", 0.4)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"maxe": "loop"}, ["unknown key", "'maxe'", "did you mean 'maze'"]),
        ({"maze": "lop"}, ["unknown maze 'lop'", "did you mean 'loop'"]),
        ({"episode_steps": 0}, ["task.episode_steps", "greater than or equal to 1"]),
        ({"noise": -0.1}, ["task.noise"]),
        ({"control_period": np.nan}, ["task.control_period", "finite"]),
        ({"turn_rate": "fast"}, ["task.turn_rate", "'fast'"]),
        ({"start": "anywhere"}, ["task.start", "'fixed' or 'random'"]),
        ({"kept": [-1]}, ["task.kept.0"]),
        ({"kept": []}, ["task.kept", "at least 1"]),
        ({"edges": [2.0, 1.0]}, ["task.edges", "strictly increase"]),
        ({"observation": "pixels"}, ["unknown observation 'pixels'"]),
    ],
)
@pytest.mark.parametrize("task", ["maze", Wander()], ids=["name", "Task"])
def test_a_setting_that_does_not_fit_is_refused_by_name(task, settings, words):
    with pytest.raises(InputError) as error:
        make_env(task, **settings)
    for word in words:
        assert word in str(error.value)
