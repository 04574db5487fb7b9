"""Both cameras of a film show the robot, the world of the episode, and its goal."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.rendering.colours import BODY
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


def first_picture(camera: str, make, config, robot=None) -> np.ndarray:
    frames, scene = make.frames(make.policy(), config)
    if robot:
        scene = replace(scene, spec=replace(scene.spec, robot=robot))
    with closing(CAMERAS[camera](scene)) as view:
        return view.picture(frames[0])


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_from_above_shows_the_robot_where_it_is(suffix, make, pictures, tmp_path):
    config = make.config(start="fixed", beams=1)
    shown = pictures(film(make.policy(), tmp_path / f"it{suffix}", config, options=FilmOptions(steps=STEPS)))
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
    text = "boxes: [{centre: [4, 0], size: [1, 1]}]\nstart: [0, 0, 0]\nbounds: [-5, -5, 5, 5]\n"
    shown = {}
    for name, task, goal in (
        ("aim", "wall", "goal: [2, 1, 0]"),
        ("goal", "maze", "goal: [2, 1, 0]"),
        ("no", "maze", ""),
    ):
        (tmp_path / f"{name}.yaml").write_text(text + goal)
        shown[name] = first_picture(
            camera, make, make.config(task, world=str(tmp_path / f"{name}.yaml"), start="fixed")
        )
    assert (shown["goal"] == shown["no"]).all(), "a world's goal is not the task's"
    assert len(green(shown["aim"])) > len(green(shown["no"])) + 50
    columns = green(shown["aim"])[:, 1]
    if camera == "above":
        assert columns.max() / 640 == pytest.approx((2.0 + 5.0 + 0.3 + 0.2) / 10.6, abs=0.01)  # the ring's right end
    else:
        assert 100 < columns.min() < 250  # ahead and to the left


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
    config = make.config(start="fixed", beams=1)
    widths = []
    for scale in (1.0, 2.0):
        robot = replace(config.scene.robot, radius=scale * config.scene.robot.radius)
        picture = first_picture("above", make, config, robot).astype(int)
        body = np.argwhere((np.abs(picture - ImageColor.getrgb(BODY)) < 12).all(axis=2))
        widths.append(np.ptp(body, axis=0)[1])
    assert widths[1] == pytest.approx(2 * widths[0], abs=4)
    robots = ("turtlebot2", "turtlebot3")
    chased = [first_picture("chase", make, make.config(start="fixed", robot=robot)) for robot in robots]
    large, small = ((picture.max(axis=2) < 90).sum() for picture in chased)
    assert 0.1 * large < small < 0.5 * large
