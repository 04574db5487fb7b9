"""The top-down image of `render`, and the page of mode "human"."""

import re
import time
from unittest.mock import Mock, call
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest

from tb2rl.envs.turtlebot2_env import TurtleBot2Env

CORNER = (-3.75, -3.75, 0.0)  # the start of the world "loop"


def pixel(world, image, x, y):
    """The colour at a place [m]; the image shows the world's bounds and 0.3 m around them."""
    x0, y0, x1, y1 = world.bounds
    height, width, _ = image.shape
    column = (x - x0 + 0.3) / (x1 - x0 + 0.6) * width
    row = (y1 + 0.3 - y) / (y1 - y0 + 0.6) * height
    return image[int(row), int(column)].astype(int)


def is_wall(colour):
    red, green, blue = colour
    return red > green + 40 > blue + 40


def test_an_image_shows_the_walls_and_the_robot_where_it_is(make, drive):
    env = make(render_mode="rgb_array", start="fixed", beams=1)
    assert env.render() is None  # nothing to show yet
    env.reset()
    before = env.render()
    assert before.dtype == np.uint8
    assert before.ndim == 3
    drive(env, [0] * 10)
    after, world = env.render(), env.scene.world
    tail = CORNER[0] - 0.12, CORNER[1]  # behind the middle of the body, off its wheels and its nose
    now = env.path[-1][0] - 0.12, env.path[-1][1]
    assert pixel(world, before, *tail).max() < 80
    assert pixel(world, after, *now).max() < 80
    assert pixel(world, after, *tail).min() > 200  # floor again
    assert pixel(world, before, *now).max() > 200
    assert is_wall(pixel(world, before, 1.25, 1.25))
    assert (before != after).any()


def test_an_image_shows_the_goal_that_there_is(make):
    images = []
    for goal in ((5.0, 0.0), (4.0, 2.0)):
        env = make("wall", goal=goal, render_mode="rgb_array", simulation="kinematic", start="fixed", beams=1)
        env.reset()
        images.append(env.render())
    for x, y, shown in ((5.2, 0.0, 0), (4.2, 2.0, 1)):  # the rings' right ends
        red, green, blue = pixel(env.scene.world, images[shown], x, y)
        assert green > red + 40 > blue
        assert pixel(env.scene.world, images[1 - shown], x, y).min() > 200


def test_an_image_shows_the_world_that_the_episode_is_in(make):
    env = make(world=["loop", "circuit"], render_mode="rgb_array", simulation="kinematic", start="fixed", beams=1)
    env.reset(options={"world": 1})
    circuit = env.scene.spec.worlds[1]
    assert is_wall(pixel(circuit, env.render(), 4.5, 2.25))
    assert pixel(circuit, env.render(), circuit.start[0] - 0.12, circuit.start[1]).max() < 80


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
def test_mode_human_shows_every_state_on_a_page_until_the_environment_is_closed(simulation, make, drive, capsys):
    env = make(render_mode="human", simulation=simulation, control_period=0.01)
    (address,) = re.fullmatch(r"watch the robot at (http://localhost:\d+)\n", capsys.readouterr().out).groups()
    env.viewer.show = Mock(wraps=env.viewer.show)
    env.reset()
    drive(env, [0, 1])
    assert env.viewer.show.call_args_list == [call(env)] * 3
    assert env.render() is None
    with urlopen(address) as page:
        assert page.status == 200
    env.close()
    with pytest.raises(URLError):
        urlopen(address)


def test_mode_human_takes_as_long_as_a_robot(make, drive):
    env = make(render_mode="human", simulation="kinematic", control_period=0.1)
    env.reset()
    began = time.monotonic()
    drive(env, [1] * 5)
    assert 0.49 < time.monotonic() - began < 2.0


def test_the_frame_rate_is_that_of_the_control_steps(make):
    assert make(control_period=0.1).metadata["render_fps"] == 10
    assert make(control_period=5.0).metadata["render_fps"] == 1
    assert TurtleBot2Env.metadata["render_fps"] == 5
