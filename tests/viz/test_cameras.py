"""The pictures of a film show the robot, the world of the episode, its goal, and the values of each frame."""

import math
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.evaluation.episodes import EpisodeStep
from tb2rl.rendering.above import HEADER_HEIGHT
from tb2rl.rendering.colours import FAILED
from tb2rl.simulation import RobotState
from tb2rl.viz.cameras import (
    CAMERAS,
    CAPTION_HEIGHT,
    add_caption,
    caption_values,
    draw_caption,
    film_frames,
    interpolate_pose,
)
from tb2rl.viz.film import FilmOptions, film

STEPS = 10


def pixel(world, picture, x, y) -> tuple[int, int]:
    """Row and column of a point in a picture from above of a square world."""
    x0, y0, x1, y1 = world.bounds
    side = picture.shape[1]
    return int((y1 + 0.3 - y) / (y1 - y0 + 0.6) * side), int((x - x0 + 0.3) / (x1 - x0 + 0.6) * side)


def first_picture(camera: str, make, config) -> np.ndarray:
    frames, scene = make.frames(make.policy(), config)
    with closing(CAMERAS[camera](scene)) as view:
        return view.picture(frames[0])


# ---- frames


@pytest.fixture
def steps(make_robot_state) -> list[EpisodeStep]:
    """An episode of ten steps along x, 0.1 m a step; a post moves the other way, as fast."""

    def robot_state(x: float) -> RobotState:
        return make_robot_state(pose=(x, 0.0, 0.0), dynamic_obstacles=np.array([[(3.0 - x, 1.0, -1.0, 0.0, 0.2, 0.0)]]))

    states = [robot_state(0.1 * step) for step in range(11)]
    infos = [{"ended": None, "failed": False}] * 9 + [{"ended": "goal", "failed": False}]
    return [EpisodeStep(i + 1, states[i], states[i + 1], np.array(0), 1.0, i + 1.0, infos[i]) for i in range(10)]


@pytest.mark.parametrize(("rate", "speed"), [(30, 1.0), (10, 4.0), (10, 0.5)])
def test_frames_show_the_robot_and_obstacles_at_each_instant(rate, speed, steps):
    frames = list(film_frames(steps, period=0.2, rate=rate, speed=speed))
    during, end = [frame for frame in frames if not frame.ended], [frame for frame in frames if frame.ended]
    assert len(during) == math.ceil(10 * 0.2 * rate / speed - 1e-9)
    assert [frame.time for frame in during] == pytest.approx([i * speed / rate for i in range(len(during))])
    assert [frame.pose[0] for frame in during] == pytest.approx([0.5 * frame.time for frame in during])
    assert len(end) == rate, "a second of the last frame"
    assert {(frame.time, frame.pose[0], frame.step.episode_return) for frame in end} == {(2.0, 1.0, 10.0)}
    for frame in frames:
        assert frame.dynamic_obstacles.tolist() == [pytest.approx([3.0 - frame.pose[0], 1.0, -1.0, 0.0, 0.2, 0.0])]
        assert [pose[0] for pose in frame.path] == pytest.approx([0.1 * i for i in range(frame.step.number)])


def test_poses_are_interpolated_by_the_shorter_turn():
    before, after = np.array([0.0, 0.0, math.pi - 0.1]), np.array([1.0, 2.0, 0.1 - math.pi])
    assert interpolate_pose(before, after, 0.25) == pytest.approx([0.25, 0.5, math.pi - 0.05])


# ---- pictures


def test_a_film_from_above_shows_the_robot_where_it_is(make, read_film, tmp_path):
    config = make.config(start="fixed", beams=1)
    shown, _ = read_film(film(make.policy(), tmp_path / "it.gif", config, options=FilmOptions(steps=STEPS)))
    world = config.scene.world
    x, y, _ = world.start
    moved = 0.5 * 0.2 * STEPS - 0.04  # less the acceleration
    for picture, here, elsewhere in ((shown[0], x, x + moved), (shown[-1], x + moved, x)):
        picture = picture[HEADER_HEIGHT:]
        beside = -0.09, y + 0.09  # a spot of the body alone, off its wheels, its nose, its path and its beam
        assert picture[pixel(world, picture, here + beside[0], beside[1])].max() < 90
        assert picture[pixel(world, picture, elsewhere + beside[0], beside[1])].min() > 190


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_goal_is_shown_if_the_task_has_one(camera, make, green, tmp_path):
    file = tmp_path / "mine.yaml"
    places = "start: [0, 0, 0]\nbounds: [-5, -5, 5, 5]\ngoal: [2, 1, 0]"
    file.write_text(f"boxes: [{{centre: [4, 0], size: [1, 1]}}]\n{places}")
    configs = [make.config(task, world=str(file), start="fixed") for task in ("wall", "maze")]
    shown, without = (green(first_picture(camera, make, config)) for config in configs)
    assert len(shown) > len(without) + 50, "a world's goal is not the task's"


def test_each_episode_shows_its_own_goal(make, green):
    frames, scene = make.frames(make.policy(), make.config("wall", world="loop", goal=[0.0, 0.0]))
    frame, goals = frames[0], np.random.default_rng(0).uniform(-1.0, 1.0, (3, 2))
    with closing(CAMERAS["above"](scene)) as camera:
        for x, y in goals:
            initial_state = replace(frame.step.after.initial_state, table=frame.step.after.initial_state.table.copy())
            initial_state.goal[:] = x, y
            after = replace(frame.step.after, initial_state=initial_state)
            picture = camera.picture(replace(frame, step=replace(frame.step, after=after)))
            row, column = pixel(scene.world, picture, x + 0.2, y)  # the ring's right end
            assert len(green(picture[row - 3 : row + 4, column - 3 : column + 4])), (x, y)


@pytest.mark.bullet
def test_a_robot_is_shown_in_its_size(make):
    configs = [make.config(start="fixed", beams=1, robot=robot) for robot in ("turtlebot2", "turtlebot3")]
    large, small = ((first_picture("chase", make, config).max(axis=2) < 90).sum() for config in configs)
    assert 0.1 * large < small < 0.5 * large


# ---- captions


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_legend_names_what_a_picture_shows(camera, make):
    for task, settings, shown in (
        ("maze", {}, set()),
        ("wall", {}, {"goal"}),
        ("wall", {"dynamic_obstacles": {"posts": 1}}, {"goal", "moving obstacle"}),
    ):
        frames, scene = make.frames(make.policy(), make.config(task, **settings))
        with closing(CAMERAS[camera](scene)) as view:
            labels = {mark.label for mark in view.legend(frames[0], scene)}
        assert labels == shown | {"wall"} | ({"path", "laser", "1 m"} if camera == "above" else {"tiles of 1 m"})


@pytest.mark.parametrize(("action", "described"), [([1.0, 0.0], "0.50, +0.00"), ([0.0, -0.5], "0.25, -0.50")])
def test_velocities_are_described_by_their_values(action, described, make, cruise):
    frames, scene = make.frames(make.policy(action), make.config(cruise, start="fixed"), 5)
    assert caption_values(frames[0], scene)["action"] == described
    assert caption_values(frames[-1], scene)["ended"] == "time limit"


def test_the_caption_says_why_a_filter_changes_the_command(make):
    settings = {"world": "wall", "start": "fixed", "beams": 37, "collision_range": 0.0}
    config = make.config("maze", **settings, filters=["safety"])
    frames, scene = make.frames(make.policy(), config, 60)
    texts = [caption_values(frame, scene).get("filter") for frame in frames]
    assert texts[0] is None
    assert "an obstacle is in the way" in texts


@pytest.mark.parametrize(
    ("ended", "failed", "task", "settings"),
    [
        ("collision", True, "maze", {}),
        ("out of bounds", True, "wall", {"bounds": [-1.0, -3.0, 0.5, 3.0]}),
        ("goal", False, "wall", {"goal": [1.0, 0.0], "collision_range": 0.0}),
    ],
)
def test_failed_endings_are_red(ended, failed, task, settings, make, coloured):
    frames, scene = make.frames(make.policy(), make.config(task, start="fixed", **settings), 100)
    assert caption_values(frames[-1], scene)["ended"] == ended
    assert "action" not in caption_values(frames[-1], scene)
    first, last = (add_caption(np.zeros((20, 640, 3), np.uint8), frames[i], scene) for i in (0, -1))
    assert last.shape == (20 + CAPTION_HEIGHT, 640, 3)
    assert (len(coloured(first, FAILED)), len(coloured(last, FAILED)) > 20) == (0, failed)
    if ended == "collision":
        values = {"v [m/s]": "0.50", "w [rad/s]": "+0.00", "action": "forward", "reward": "+5", "return": "55"}
        assert caption_values(frames[20], scene) == {"time [s]": "2.0", **values}


def test_narrow_pictures_are_centred_and_long_values_stay_in_their_columns(make):
    frames, scene = make.frames(make.policy(), make.config())
    picture = add_caption(np.zeros((10, 100, 3), np.uint8), frames[0], scene)
    assert picture.shape == (10 + CAPTION_HEIGHT, 560, 3)
    assert not picture[:10, 230:330].any()
    assert picture[:10, :230].min() > 200
    strip = np.array(draw_caption(300, {"action": "straight on and then to the left", "": "", "return": "1"}))
    assert strip[:, 100:200].min() == 255, "the column in the middle is empty"
    for number, text in ((0.0877799, "+0.0878"), (-1.61075, "-1.61"), (1234.5, "+1234"), (-0.0, "+0")):
        frame = replace(frames[0], step=replace(frames[0].step, reward=number))
        assert caption_values(frame, scene)["reward"] == text
