"""Dynamic obstacles as a setting of any task and of a world's file."""

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import task_names
from tb2rl.rendering.colours import DYNAMIC_OBSTACLE
from tb2rl.tasks.task import COLLISION, DYNAMIC_COLLISION

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
    assert env.robot_state.initial_state.records["mass"] != 1.0
    assert (env.robot_state.dynamic_obstacles[..., 4] == 0.25).sum() == 2
    for _ in range(3):
        assert env.observation_space.contains(env.step(env.action_space.sample())[0])


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
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


def test_a_world_and_a_task_have_at_most_fifty_dynamic_obstacles_together(hall, make):
    make("maze", simulation="kinematic", world=hall, dynamic_obstacles={"people": 49})
    words = r"world hall and task\.dynamic_obstacles: must be at most 50 dynamic obstacles, got 51"
    with pytest.raises(InputError, match=words):
        make("maze", world=hall, dynamic_obstacles={"people": 50})


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
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
            assert info["failed"] == (info["ended"] in (COLLISION, DYNAMIC_COLLISION))
    assert DYNAMIC_COLLISION in ended[1]
    assert COLLISION not in ended[1]
    assert COLLISION in ended[0]


def test_render_shows_dynamic_obstacles(make):
    obstacles = {"posts": 1, "radius": 0.4}
    env = make("maze", simulation="kinematic", dynamic_obstacles=obstacles, render_mode="rgb_array", beams=1)
    env.reset(seed=1)
    colour = [int(DYNAMIC_OBSTACLE[i : i + 2], 16) for i in (1, 3, 5)]
    assert (np.abs(env.render().astype(int) - colour).max(axis=2) < 12).sum() > 100
