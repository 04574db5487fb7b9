"""Things that move as a setting of any task and of a world's file, in every face of an environment."""

from __future__ import annotations

import copy

import gymnasium as gym
import numpy as np
import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import task_names
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.rendering.colours import DYNAMIC_OBSTACLE
from tb2rl.runs.layers import resolve
from tb2rl.tasks.outcome import COLLISION, OBSTACLE_COLLISION
from tb2rl.tasks.wander import Wander

OBSTACLE_SEED = [{"people": 3, "speed": 1.0}, {"boxes": 1}]
HALL = """
walls: [{path: [[-4, -4], [4, -4], [4, 4], [-4, 4]], closed: true}]
start: [0, 0, 0]
goal: [3, 3, 0]
dynamic_obstacles:
  - {posts: 1, radius: 0.2, path: [[2, -1], [2, 1]], speed: 0.5}
"""


def make(simulation="kinematic", observation="raw", **settings):
    return tb2rl.make_env("maze", observation, simulation=simulation, **{"world": "loop", **settings})


def rollout(num_envs, steps=60, **settings):
    env = TurtleBot2VecEnv(
        make_scene(Wander(dynamic_obstacles=OBSTACLE_SEED, **{"episode_steps": 25, **settings}), "raw"), num_envs
    )
    env.seed(0)
    seen, chosen = [env.reset()], np.random.default_rng(1).integers(3, size=(steps, 80))
    seen += [env.step(actions[:num_envs]) for actions in chosen]
    return env, seen


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("name", task_names())
def test_every_task_can_have_movers(name, simulation):
    with tb2rl.make_env(name, simulation=simulation, dynamic_obstacles={"people": 2}) as env:
        env.reset(seed=0)
        assert (env.robot_state.dynamic_obstacles[..., 4] == 0.25).sum() == 2
        for _ in range(3):
            assert env.observation_space.contains(env.step(env.action_space.sample())[0])


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_worlds_file_can_hold_movers(simulation, tmp_path):
    (tmp_path / "hall.yaml").write_text(HALL)
    with make(simulation, world=str(tmp_path / "hall.yaml"), dynamic_obstacles={"people": 1}) as env:
        env.reset(seed=0)
        assert env.robot_state.dynamic_obstacles.shape == (1, 2, 6)
        radii = env.robot_state.dynamic_obstacles[0, :, 4]
        assert sorted(radii) == [0.2, 0.25]
        post = int(np.argmin(radii))
        assert env.robot_state.dynamic_obstacles[0, post, 0] == pytest.approx(2.0)
        before = env.robot_state.dynamic_obstacles[0, post, 1]
        env.step(1)
        assert abs(env.robot_state.dynamic_obstacles[0, post, 1] - before) == pytest.approx(0.1, abs=0.1001)
        assert env.robot_state.dynamic_obstacles[0, post, 1] != before


@pytest.mark.parametrize("setting", [{"peeple": 3}, {"people": -1}, {}, 4, "people", [4], {"people": 99}])
def test_what_does_not_fit_is_said_when_it_is_made(setting):
    with pytest.raises(InputError, match=r"task\.dynamic_obstacles") as caught:
        make(dynamic_obstacles=setting)
    assert "\n" not in str(caught.value)


def test_a_world_and_a_task_have_at_most_fifty_movers_together(tmp_path):
    (tmp_path / "hall.yaml").write_text(HALL)
    make(world=str(tmp_path / "hall.yaml"), dynamic_obstacles={"people": 49})
    with pytest.raises(InputError, match=r"world hall and task\.dynamic_obstacles: must be at most 50 movers, got 51"):
        make(world=str(tmp_path / "hall.yaml"), dynamic_obstacles={"people": 50})


def test_a_config_keeps_the_setting():
    config = resolve(
        "qlearn", settings={"task.dynamic_obstacles": [{"people": 2}, {"posts": 1, "path": [[0, 0], [1, 0]]}]}
    )
    assert len(config.scene.spec.dynamic_obstacles) == 2
    assert resolve("qlearn").to_dict()["task"]["dynamic_obstacles"] is None


def test_a_robot_alone_is_where_it_would_be_among_people():
    starts = []
    for dynamic_obstacles in (None, {"people": 3}):
        env = TurtleBot2VecEnv(make_scene(Wander(dynamic_obstacles=dynamic_obstacles, variation="mild"), "raw"), 30)
        env.seed(0)
        env.reset()
        starts.append(env.loop.robot_state.pose)
    np.testing.assert_array_equal(*starts)


def test_what_a_robot_meets_does_not_depend_on_how_many_others_there_are():
    (_, few), (_, many) = rollout(10), rollout(80)
    np.testing.assert_array_equal(few[0], many[0][:10])
    for one, other in zip(few[1:], many[1:], strict=True):
        np.testing.assert_array_equal(one[0], other[0][:10])
        np.testing.assert_array_equal(one[1], other[1][:10])


def test_a_batch_goes_on_from_a_state_to_the_bit():
    env, _ = rollout(40, laser_noise=0.01, variation="strong")
    state = copy.deepcopy(env.state())
    chosen = np.random.default_rng(9).integers(3, size=(40, 40))
    expected = [env.step(actions) for actions in chosen]
    other, _ = rollout(40, steps=3, laser_noise=0.01, variation="strong")
    other.restore(state)
    for actions, answer in zip(chosen, expected, strict=True):
        np.testing.assert_equal(other.step(actions), answer)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_an_environment_goes_on_from_a_state_and_as_a_copy_to_the_bit(simulation):
    env, other = (make(simulation, dynamic_obstacles=OBSTACLE_SEED) for _ in range(2))
    env.reset(seed=3)
    for _ in range(4):
        env.step(1)
    state = copy.deepcopy(env.state())  # PyBullet rounds here, so the copy comes after it
    copied = copy.deepcopy(env)
    other.restore(state)
    np.testing.assert_equal(other.robot_state.state(), env.robot_state.state())
    assert other.robot_state.dynamic_obstacles.shape == (1, 4, 6)
    first, *others = (
        [
            (each.step(action)[0], each.robot_state.dynamic_obstacles, each.robot_state.nearest_is_dynamic)
            for action in (0, 1, 2, 1) * 5
        ]
        for each in (env, other, copied)
    )
    for each in others:
        np.testing.assert_equal(each, first)
    for each in (env, other, copied):
        each.close()


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_episodes_end_in_crashes_of_both_kinds(simulation):
    """A robot that stands is run into; one that drives ahead hits a wall."""
    ended = {0: set(), 1: set()}
    settings = {"collision_range": 0.0, "episode_steps": 120, "turn_speed": 0.0, "turn_rate": 1e-6}
    with make(simulation, dynamic_obstacles={"people": 6, "speed": 1.0}, **settings) as env:
        for seed in range(6):
            for action in ended:
                env.reset(seed=seed)
                over = False
                while not over:
                    *_, terminated, truncated, info = env.step(action)
                    over = terminated or truncated
                ended[action].add(info["ended"])
                assert info["failed"] == (info["ended"] in (COLLISION, OBSTACLE_COLLISION))
    assert OBSTACLE_COLLISION in ended[1]
    assert COLLISION not in ended[1]
    assert COLLISION in ended[0]


def test_the_twins_infos_name_both_kinds():
    env, seen = rollout(80, steps=200, collision_range=0.2, episode_steps=1500)
    ended = [info["ended"] for step in seen[1:] for info in step[3] if "ended" in info]
    assert {COLLISION, OBSTACLE_COLLISION} <= set(ended)
    assert env.num_envs == 80


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_render_shows_what_moves_where_it_is(simulation):
    with make(simulation, dynamic_obstacles={"posts": 1, "radius": 0.4}, render_mode="rgb_array", beams=1) as env:
        env.reset(seed=1)
        for _ in range(3):
            env.step(1)
            picture, (x, y) = env.render().astype(int), env.robot_state.dynamic_obstacles[0, 0, :2]
            colour = [int(DYNAMIC_OBSTACLE[i : i + 2], 16) for i in (1, 3, 5)]
            rows, columns = np.nonzero(np.abs(picture - colour).max(axis=2) < 12)
            x0, _, x1, y1 = env.scene.world.bounds
            scale = picture.shape[1] / (x1 - x0 + 0.6)
            assert (columns.mean() + 0.5) / scale + x0 - 0.3 == pytest.approx(x, abs=0.03)
            assert y1 + 0.3 - (rows.mean() + 0.5) / scale == pytest.approx(y, abs=0.03)
            assert len(rows) == pytest.approx(np.pi * 0.4**2 * scale**2, rel=0.05)


def test_gymnasiums_vector_environment_has_movers_too():
    env = gym.make_vec(
        "TurtleBot2Maze-v0", num_envs=3, dynamic_obstacles={"people": 6}, simulation="kinematic", collision_range=0.0
    )
    env.reset(seed=0)
    ended = set()
    for _ in range(150):
        infos = env.step(np.ones(3, dtype=int))[4]
        ended |= set(infos.get("final_info", {}).get("ended", ()))
    env.close()
    assert OBSTACLE_COLLISION in ended
