"""Dynamic obstacles as a setting of any task and of a world's file."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import task_names
from tb2rl.rendering.colours import DYNAMIC_OBSTACLE
from tb2rl.runs.layers import resolve
from tb2rl.tasks.outcome import COLLISION, OBSTACLE_COLLISION
from tb2rl.tasks.wander import Wander

HALL = """
walls: [{path: [[-4, -4], [4, -4], [4, 4], [-4, 4]], closed: true}]
start: [0, 0, 0]
goal: [3, 3, 0]
dynamic_obstacles:
  - {posts: 1, radius: 0.2, path: [[2, -1], [2, 1]], speed: 0.5}
"""


@pytest.fixture
def hall(tmp_path):
    """The path of a world's file with one dynamic obstacle."""
    (tmp_path / "hall.yaml").write_text(HALL)
    return str(tmp_path / "hall.yaml")


@pytest.mark.parametrize("name", task_names())
def test_every_task_can_have_dynamic_obstacles_and_variation(name, make):
    world = {} if name == "wall" else {"world": "maze"}
    env = make(name, simulation="kinematic", dynamic_obstacles={"people": 2}, variation="strong", **world)
    env.reset(seed=0)
    assert (env.robot_state.initial_state.parameters != env.scene.robot.parameters).any()
    assert (env.robot_state.dynamic_obstacles[..., 4] == 0.25).sum() == 2
    for _ in range(3):
        assert env.observation_space.contains(env.step(env.action_space.sample())[0])


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_worlds_file_can_have_dynamic_obstacles(simulation, hall, make):
    env = make("maze", simulation=simulation, world=hall, dynamic_obstacles={"people": 1})
    env.reset(seed=0)
    radii = env.robot_state.dynamic_obstacles[0, :, 4]
    assert sorted(radii) == [0.2, 0.25]
    post = int(np.argmin(radii))
    x, before = env.robot_state.dynamic_obstacles[0, post, :2]
    assert x == pytest.approx(2.0)
    env.step(1)
    assert 0.0 < abs(env.robot_state.dynamic_obstacles[0, post, 1] - before) < 0.2001


@pytest.mark.parametrize("setting", [{"peeple": 3}, {"people": -1}, {}, 4, "people", [4], {"people": 99}])
def test_a_setting_that_does_not_fit_is_refused_in_one_line(setting):
    with pytest.raises(InputError, match=r"task\.dynamic_obstacles") as error:
        tb2rl.make_env("maze", dynamic_obstacles=setting)
    assert "\n" not in str(error.value)


def test_a_world_and_a_task_have_at_most_fifty_dynamic_obstacles_together(hall, make):
    make("maze", simulation="kinematic", world=hall, dynamic_obstacles={"people": 49})
    words = r"world hall and task\.dynamic_obstacles: must be at most 50 dynamic obstacles, got 51"
    with pytest.raises(InputError, match=words):
        make("maze", world=hall, dynamic_obstacles={"people": 50})


def test_a_config_keeps_the_setting():
    said = [{"people": 2}, {"posts": 1, "path": [[0, 0], [1, 0]]}]
    assert len(resolve("qlearn", settings={"task.dynamic_obstacles": said}).scene.spec.dynamic_obstacles) == 2
    assert resolve("qlearn").to_dict()["task"]["dynamic_obstacles"] is None


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_episodes_end_in_collisions_of_both_kinds(simulation, make, drive):
    """A dynamic obstacle runs into a robot at rest; a robot that drives straight on hits a wall."""
    ended = {0: set(), 1: set()}
    settings = {"collision_range": 0.0, "episode_steps": 120, "turn_speed": 0.0, "turn_rate": 1e-6}
    env = make("maze", simulation=simulation, dynamic_obstacles={"people": 6, "speed": 1.0}, **settings)
    for seed in range(6):
        for action in ended:
            env.reset(seed=seed)
            *_, info = drive(env, [action] * 120)[-1]
            ended[action].add(info["ended"])
            assert info["failed"] == (info["ended"] in (COLLISION, OBSTACLE_COLLISION))
    assert OBSTACLE_COLLISION in ended[1]
    assert COLLISION not in ended[1]
    assert COLLISION in ended[0]


def test_infos_of_many_environments_name_both_kinds(start_vec_env):
    task = Wander(dynamic_obstacles=[{"people": 3, "speed": 1.0}, {"boxes": 1}], collision_range=0.2)
    env, _ = start_vec_env(task, num_envs=80)
    steps = [env.step(actions) for actions in np.random.default_rng(1).integers(3, size=(150, 80))]
    ended = {info["ended"] for step in steps for info in step[3] if info}
    assert {COLLISION, OBSTACLE_COLLISION} <= ended


def test_gymnasiums_vector_environment_has_dynamic_obstacles_too():
    settings = {"dynamic_obstacles": {"people": 6}, "simulation": "kinematic", "collision_range": 0.0}
    env = gym.make_vec("tb2rl:TurtleBot2Maze-v0", num_envs=3, **settings)
    env.reset(seed=0)
    steps = [env.step(np.ones(3, dtype=int)) for _ in range(150)]
    assert any(OBSTACLE_COLLISION in step[4].get("final_info", {}).get("ended", ()) for step in steps)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_render_shows_dynamic_obstacles_where_they_are(simulation, make):
    obstacles = {"posts": 1, "radius": 0.4}
    env = make("maze", simulation=simulation, dynamic_obstacles=obstacles, render_mode="rgb_array", beams=1)
    env.reset(seed=1)
    for _ in range(3):
        env.step(1)
        image, (x, y) = env.render().astype(int), env.robot_state.dynamic_obstacles[0, 0, :2]
        colour = [int(DYNAMIC_OBSTACLE[i : i + 2], 16) for i in (1, 3, 5)]
        rows, columns = np.nonzero(np.abs(image - colour).max(axis=2) < 12)
        x0, _, x1, y1 = env.scene.world.bounds
        scale = image.shape[1] / (x1 - x0 + 0.6)
        assert (columns.mean() + 0.5) / scale + x0 - 0.3 == pytest.approx(x, abs=0.03)
        assert y1 + 0.3 - (rows.mean() + 0.5) / scale == pytest.approx(y, abs=0.03)
        assert len(rows) == pytest.approx(np.pi * 0.4**2 * scale**2, rel=0.05)
