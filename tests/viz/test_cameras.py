"""Both cameras of a film show the robot where it is, the world of the episode, and its goal."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.evaluation.rollout import roll_out
from tb2rl.rendering.colours import BODY
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.film import film, open_env
from tb2rl.viz.shots import shots
from tb2rl.worlds.registry import find_world

STEPS = 10


def place(world, picture, x, y) -> tuple[int, int]:
    """Row and column of a point in a picture from above of a square world."""
    x0, y0, x1, y1 = world.bounds
    side = picture.shape[1]
    return int((y1 + 0.3 - y) / (y1 - y0 + 0.6) * side), int((x - x0 + 0.3) / (x1 - x0 + 0.6) * side)


def green(picture: np.ndarray) -> np.ndarray:
    """Row and column of what is green, as goals are, shape (pixels, 2)."""
    picture = picture.astype(int)
    return np.argwhere((picture[..., 1] - picture[..., 0] > 30) & (picture[..., 1] - picture[..., 2] > 30))


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_the_robot_is_where_it_drives(suffix, make, frames, tmp_path):
    config = make.config(start="fixed", beams=1)
    pictures = frames(film(make.policy(), tmp_path / f"drive{suffix}", config, steps=STEPS))
    world = find_world("loop")
    x, y, _ = world.start
    gone = 0.5 * 0.2 * STEPS - 0.04  # it has to gather speed
    for picture, here, elsewhere in ((pictures[0], x, x + gone), (pictures[-1], x + gone, x)):
        beside = -0.09, y + 0.09  # a spot of the body alone, off its wheels, its nose, its path and its beam
        assert picture[place(world, picture, here + beside[0], beside[1])].max() < 90
        assert picture[place(world, picture, elsewhere + beside[0], beside[1])].min() > 190


def test_the_chase_camera_stays_behind_the_robot(make, frames, tmp_path):
    path = film(make.policy(), tmp_path / "drive.mp4", make.config(start="fixed"), steps=STEPS, camera="chase")
    pictures = frames(path)
    for picture in (pictures[0], pictures[-1]):
        assert picture[250, 320].max() < 90
        assert picture[340, 320].min() > 180  # floor
        assert ((picture[:360, :, 0] - picture[:360, :, 2].astype(int)) > 40).mean() > 0.05  # brick walls


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_film_shows_the_goal(camera, make, frames, tmp_path):
    config = make.config("wall", start="fixed", goal=[2.0, 1.0])
    path = film(make.policy(), tmp_path / "drive.mp4", config, steps=1, camera=camera)
    columns = green(frames(path)[0])[:, 1]
    if camera == "above":
        assert columns.max() / 640 == pytest.approx((2.0 + 1.0 + 0.3 + 0.2) / 7.6, abs=0.01)  # the ring's right end
    else:
        assert 100 < columns.min() < 250  # ahead and to the left


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_task_without_a_goal_shows_none_though_its_world_has_one(camera, make, tmp_path):
    text = "boxes: [{centre: [4, 0], size: [1, 1]}]\nstart: [0, 0, 0]\nbounds: [-5, -5, 5, 5]\n"
    pictures = {}
    for name, task, more in (
        ("aim", "wall", "goal: [2, 1, 0]"),
        ("goal", "maze", "goal: [2, 1, 0]"),
        ("no", "maze", ""),
    ):
        (tmp_path / f"{name}.yaml").write_text(text + more)
        config = make.config(task, world=str(tmp_path / f"{name}.yaml"), start="fixed")
        policy, env = open_env(make.policy(), config, {}, steps=1)
        with closing(env), closing(CAMERAS[camera](env.scene)) as camera:
            pictures[name] = camera.picture(next(shots(roll_out(env, policy, 0), period=0.2, rate=10)))
    assert (pictures["goal"] == pictures["no"]).all()
    assert len(green(pictures["aim"])) > len(green(pictures["no"])) + 50


def test_each_episode_shows_its_own_goal(make, errands):
    policy, env = open_env(make.policy(), make.config(errands), {}, steps=1)
    world = env.scene.world
    with closing(env), closing(CAMERAS["above"](env.scene)) as camera:
        for seed in range(3):
            shown = list(shots(roll_out(env, policy, seed), period=0.2, rate=10))
            x, y = shown[0].moment.initial_state.goal[0]
            picture = camera.picture(shown[0])
            row, column = place(world, picture, x + 0.2, y)  # the ring's right end
            found = green(picture[row - 3 : row + 4, column - 3 : column + 4])
            assert len(found), (x, y)


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_turtlebot3_is_shown_smaller_than_a_turtlebot2(camera, make):
    dark = []
    for robot in ("turtlebot2", "turtlebot3"):
        config = make.config(start="fixed", beams=1, robot=robot)
        policy, env = open_env(make.policy(), config, {}, steps=1)
        with closing(env), closing(CAMERAS[camera](env.scene)) as camera:
            picture = camera.picture(next(shots(roll_out(env, policy, 0), period=0.2, rate=10)))
        dark.append((picture.max(axis=2) < 90).sum())
    assert 0.1 * dark[0] < dark[1] < 0.5 * dark[0]


def test_a_robot_of_another_size_is_shown_as_large_as_it_is(make):
    scene = make.config(start="fixed", beams=1).scene
    sizes = []
    for larger in (1.0, 2.0):
        robot = replace(scene.robot, radius=larger * scene.robot.radius)
        policy, env = open_env(make.policy(), make.config(start="fixed", beams=1), {}, steps=1)
        bigger = replace(env.scene, spec=replace(env.scene.spec, robot=robot))
        with closing(env), closing(CAMERAS["above"](bigger)) as camera:
            picture = camera.picture(next(shots(roll_out(env, policy, 0), period=0.2, rate=10)))
        body = [int(BODY[i : i + 2], 16) for i in (1, 3, 5)]
        sizes.append(np.ptp(np.argwhere((np.abs(picture.astype(int) - body) < 12).all(axis=2)), axis=0)[1])
    assert sizes[1] == pytest.approx(2 * sizes[0], abs=4)
