"""Both cameras of a film show the robot, the world of the episode, and its goal."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.film import FilmOptions, film

STEPS = 10


def pixel(world, picture, x, y) -> tuple[int, int]:
    """Row and column of a point in a picture from above of a square world."""
    x0, y0, x1, y1 = world.bounds
    side = picture.shape[1]
    return int((y1 + 0.3 - y) / (y1 - y0 + 0.6) * side), int((x - x0 + 0.3) / (x1 - x0 + 0.6) * side)


def green(picture: np.ndarray) -> np.ndarray:
    """Row and column of green pixels, as goals are, shape (pixels, 2)."""
    picture = picture.astype(int)
    return np.argwhere((picture[..., 1] - picture[..., 0] > 30) & (picture[..., 1] - picture[..., 2] > 30))


def first_picture(camera: str, make, config) -> np.ndarray:
    frames, scene = make.frames(make.policy(), config)
    with closing(CAMERAS[camera](scene)) as view:
        return view.picture(frames[0])


def test_a_film_from_above_shows_the_robot_where_it_is(make, read_film, tmp_path):
    config = make.config(start="fixed", beams=1)
    shown, _ = read_film(film(make.policy(), tmp_path / "it.gif", config, options=FilmOptions(steps=STEPS)))
    world = config.scene.world
    x, y, _ = world.start
    moved = 0.5 * 0.2 * STEPS - 0.04  # less the acceleration
    for picture, here, elsewhere in ((shown[0], x, x + moved), (shown[-1], x + moved, x)):
        beside = -0.09, y + 0.09  # a spot of the body alone, off its wheels, its nose, its path and its beam
        assert picture[pixel(world, picture, here + beside[0], beside[1])].max() < 90
        assert picture[pixel(world, picture, elsewhere + beside[0], beside[1])].min() > 190


def test_the_chase_camera_stays_behind_the_robot(make):
    frames, scene = make.frames(make.policy(), make.config(start="fixed"), steps=STEPS)
    with closing(CAMERAS["chase"](scene)) as camera:
        for picture in (camera.picture(frames[0]), camera.picture(frames[-1])):
            assert picture[250, 320].max() < 90
            assert picture[340, 320].min() > 180  # floor
            assert ((picture[:360, :, 0] - picture[:360, :, 2].astype(int)) > 40).mean() > 0.05  # brick walls


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_goal_is_shown_if_the_task_has_one(camera, make, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "boxes: [{centre: [4, 0], size: [1, 1]}]\nstart: [0, 0, 0]\nbounds: [-5, -5, 5, 5]\ngoal: [2, 1, 0]"
    )
    shown, without = (
        green(first_picture(camera, make, make.config(task, world=str(file), start="fixed")))
        for task in ("wall", "maze")
    )
    assert len(shown) > len(without) + 50, "a world's goal is not the task's"


def test_each_episode_shows_its_own_goal(make):
    frames, scene = make.frames(make.policy(), make.config("wall", world="loop", goal=[0.0, 0.0]))
    goals = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 2))
    with closing(CAMERAS["above"](scene)) as camera:
        for x, y in goals:
            initial_state = replace(frames[0].initial_state, table=frames[0].initial_state.table.copy())
            initial_state.goal[:] = x, y
            picture = camera.picture(replace(frames[0], initial_state=initial_state))
            row, column = pixel(scene.world, picture, x + 0.2, y)  # the ring's right end
            assert len(green(picture[row - 3 : row + 4, column - 3 : column + 4])), (x, y)


def test_a_robot_is_shown_in_its_size(make):
    configs = [make.config(start="fixed", beams=1, robot=robot) for robot in ("turtlebot2", "turtlebot3")]
    pictures = [first_picture("chase", make, config) for config in configs]
    large, small = ((picture.max(axis=2) < 90).sum() for picture in pictures)
    assert 0.1 * large < small < 0.5 * large
