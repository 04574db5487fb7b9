"""`gymnasium.make`: ids, arguments, the time limit."""

from dataclasses import asdict

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from pydantic_core import to_jsonable_python

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.envs.worlds import absolute_worlds

MAZE = "tb2rl:TurtleBot2Maze-v0"


@pytest.mark.parametrize("name", tb2rl.GYM_IDS)
def test_an_id_names_the_observation_for_those_who_cannot_pass_arguments(name):
    env = gym.make(name, simulation="kinematic")
    kind = spaces.Box if "Raw" in name else spaces.MultiDiscrete
    assert isinstance(env.observation_space, kind)
    assert env.unwrapped.task == tb2rl.make_env(tb2rl.GYM_IDS[name]["task"]).task


@pytest.mark.parametrize(
    ("what", "arguments", "env_id"),
    [
        ("maze", {"simulation": "kinematic"}, "TurtleBot2Maze-v0"),
        ("maze", {"observation": "raw", "beams": 9, "world": ["loop", "circuit"]}, "TurtleBot2MazeRaw-v0"),
        ("navigate", {"robot": "jackal", "episode_steps": 7, "render_mode": "rgb_array"}, "TurtleBot2Navigate-v0"),
        ("wall", {"world": "mine.yaml", "goal": (0.5, 2)}, "TurtleBot2Wall-v0"),
    ],
)
def test_the_spec_of_an_environment_makes_it_again(what, arguments, env_id, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("bounds: [-4, -4, 4, 4]\nstart: [0, 0, 0]\n")
    env = tb2rl.make_env(what, **arguments)
    world = absolute_worlds(env.task.world)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert env.spec.id == env_id
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    there = {**asdict(env.task), "world": world}
    assert to_jsonable_python(asdict(again.unwrapped.task)) == to_jsonable_python(there)
    for one in (env, again):
        one.reset(seed=3)
    action = env.action_space.sample()
    np.testing.assert_array_equal(env.step(action)[4]["pose"], again.step(action)[4]["pose"])
    assert (again.observation_space, again.action_space) == (env.observation_space, env.action_space)
    assert (again.render_mode, type(again.unwrapped.simulator)) == (env.render_mode, type(env.simulator))
    assert again.spec.max_episode_steps == env.spec.max_episode_steps == env.task.episode_steps


def test_a_class_of_a_function_has_a_spec_for_this_process(glide):
    env = tb2rl.make_env(glide, simulation="kinematic")
    again = gym.make(env.spec)
    assert (env.spec.id, again.unwrapped.task) == ("Glide-v0", env.task)


@pytest.mark.parametrize("settings", [{"max_episode_steps": 6}, {"max_episode_steps": 6, "episode_steps": 9}])
def test_the_time_limit_of_gymnasium_is_that_of_the_task(settings, drive):
    env = gym.make(MAZE, simulation="kinematic", **settings)
    for made in (env, gym.make(env.spec)):
        made.reset(seed=1)
        *before, (*_, terminated, truncated, info) = drive(made, [1] * 10)
        assert len(before) == 5
        assert (terminated, truncated, info["ended"], info["is_success"]) == (False, True, "time limit", True)
        assert made.spec.max_episode_steps == made.unwrapped.task.episode_steps == 6


@pytest.mark.parametrize(("limit", "steps"), [(9000, 9000), (-1, 1500), (None, 1500)])
def test_it_may_be_longer_than_that_of_the_task_or_left_to_it(limit, steps):
    env = gym.make(MAZE, simulation="kinematic", max_episode_steps=limit)
    assert env.unwrapped.task.episode_steps == env.spec.max_episode_steps == steps


@pytest.mark.parametrize("make", [tb2rl.make_env, lambda **arguments: gym.make(MAZE, **arguments)])
def test_an_unknown_argument_is_a_type_error_in_the_words_of_python(make):
    with pytest.raises(TypeError, match="got an unexpected keyword argument 'frameskip'"):
        make(frameskip=4)
    with pytest.raises(InputError, match="did you mean 'world'"):
        make(wordl="loop")


def test_an_environment_with_a_page_that_is_made_again_has_a_page_of_its_own():
    env = gym.make(MAZE, simulation="kinematic", render_mode="human")
    again = gym.make(env.spec)
    assert again.render_mode == "human"
    assert again.unwrapped.viewer.server.url != env.unwrapped.viewer.server.url
    for made in (env, again):
        made.close()


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
def test_an_environment_that_was_closed_opens_with_a_reset(simulation, make, drive):
    env, fresh = (make("maze", laser_noise=0.01, simulation=simulation) for _ in range(2))
    env.reset(seed=3)
    drive(env, [0, 1, 2])
    env.close()
    with pytest.raises(InputError, match="needs a reset first"):
        env.step(0)
    env.reset(seed=3)
    fresh.reset(seed=3)
    actions = np.random.default_rng(0).integers(3, size=30)
    for one, two in zip(drive(env, actions), drive(fresh, actions), strict=True):
        np.testing.assert_array_equal(one[4]["pose"], two[4]["pose"])
