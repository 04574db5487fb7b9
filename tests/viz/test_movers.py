"""What moves is to be seen: in films by both cameras, on plans, in pictures of paths, and in the report."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from PIL import ImageColor

from tb2rl.evaluation.rollout import roll_out
from tb2rl.rendering.colours import MOVER, ROUTE
from tb2rl.rendering.plan import draw_plan
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation.bullet.obstacle_bodies import _COLOUR
from tb2rl.tasks.outcome import OBSTACLE_COLLISION
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.charts import draw_ways
from tb2rl.viz.film import film, open_env
from tb2rl.viz.keyboard import Teleop
from tb2rl.viz.pictures import draw_paths
from tb2rl.viz.shots import shots
from tb2rl.worlds.dynamic_obstacles import find_dynamic_obstacles
from tb2rl.worlds.world import World

PATH = {"posts": 1, "path": [[-3, 3], [3, 3], [3, -3]]}


def coloured(picture: np.ndarray, colour: str) -> np.ndarray:
    """Row and column of all pixels that have a colour, shape (pixels, 2)."""
    return np.argwhere(np.abs(picture.astype(int) - ImageColor.getrgb(colour)).max(axis=2) < 12)


def purple(picture: np.ndarray) -> int:
    """How many pixels have the hue of what moves, in whatever light."""
    red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
    return int(((blue - green > 25) & (blue > red + 10)).sum())


@pytest.mark.parametrize(
    "dynamic_obstacles", [{"posts": 1, "radius": 0.4}, {"boxes": 1, "size": [1.0, 0.6]}], ids=["post", "box"]
)
def test_a_film_from_above_shows_movers_where_they_are_at_each_instant(dynamic_obstacles, make):
    config = make.config(start="fixed", beams=40, dynamic_obstacles=dynamic_obstacles)
    policy, env = open_env(make.policy(1), config, {}, steps=5)
    x0, _, x1, y1 = env.scene.world.bounds
    with closing(env), closing(CAMERAS["above"](env.scene)) as camera:
        shown = [(shot, camera.picture(shot)) for shot in shots(roll_out(env, policy, 0), period=0.2, rate=15)]
    places = []
    for shot, picture in shown:
        rows, columns = coloured(picture, MOVER).T
        scale = picture.shape[1] / (x1 - x0 + 0.6)
        places.append(((columns.mean() + 0.5) / scale + x0 - 0.3, y1 + 0.3 - (rows.mean() + 0.5) / scale))
        assert places[-1] == pytest.approx(shot.dynamic_obstacles[0, :2], abs=0.03)
        area = np.pi * 0.4**2 if "posts" in dynamic_obstacles else 0.6
        assert len(rows) == pytest.approx(area * scale**2, rel=0.06), "it is as large as it is, and no beam is upon it"
    assert np.hypot(*np.subtract(places[-1], places[0])) > 0.3


def test_beams_in_a_film_end_at_what_moves(make):
    path = {"posts": 1, "radius": 0.4, "path": [[-1.5, -3.751], [-1.5, -3.749]], "speed": 1e-3}
    policy, env = open_env(make.policy(1), make.config(start="fixed", beams=3, dynamic_obstacles=path), {}, steps=1)
    with closing(env), closing(CAMERAS["above"](env.scene)) as camera:
        camera.picture(next(shots(roll_out(env, policy, 0), period=0.2, rate=15)))
        assert camera._ranges[0, 1] == pytest.approx(3.75 - 1.5 - 0.4, abs=1e-3)


def test_the_chase_camera_shows_what_is_ahead_and_not_what_has_gone(make):
    path = {"posts": 1, "radius": 0.3, "path": [[-2.0, -3.751], [-2.0, -3.749]], "speed": 1e-3}
    seen = []
    for dynamic_obstacles in (path, None):
        policy, env = open_env(
            make.policy(1), make.config(start="fixed", dynamic_obstacles=dynamic_obstacles), {}, steps=1
        )
        with closing(env), closing(CAMERAS["chase"](env.scene)) as camera:
            seen.append(purple(camera.picture(next(shots(roll_out(env, policy, 0), period=0.2, rate=10)))))
    assert seen[0] > 300
    assert seen[1] < 20


def test_both_cameras_paint_what_moves_alike():
    assert np.abs(np.array(_COLOUR[:3]) * 255 - ImageColor.getrgb(MOVER)).max() < 1


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_file_has_them_too(suffix, make, frames, tmp_path):
    config = make.config(start="fixed", dynamic_obstacles={"people": 3, "radius": 0.4})
    pictures = frames(film(make.policy(), tmp_path / f"crowd{suffix}", config, steps=2))
    assert all(purple(picture) > 1000 for picture in pictures)


def test_plans_and_pictures_of_paths_show_where_movers_go(make):
    world = World.from_shapes(
        "hall",
        start=(0, 0, 0),
        bounds=(-5, -5, 5, 5),
        dynamic_obstacles=find_dynamic_obstacles(PATH, "dynamic_obstacles"),
    )
    picture = draw_plan(world, ROBOT)
    scale = picture.shape[1] / 10.6
    rows, columns = coloured(picture, ROUTE).T
    assert columns.min() / scale - 5.3 == pytest.approx(-3.0, abs=0.1)
    assert 5.3 - rows.min() / scale == pytest.approx(3.0, abs=0.1)
    scene = make.config("maze", dynamic_obstacles=[PATH, {"people": 1}]).scene
    assert len(coloured(draw_paths(scene, [make.episode(np.zeros((2, 2)), [0])]), ROUTE)) > 500
    bare = make.config("maze").scene
    assert len(coloured(draw_paths(bare, [make.episode(np.zeros((2, 2)), [0])]), ROUTE)) == 0


def test_the_report_marks_crashes_with_movers_apart(make):
    ways = [
        make.episode([(0, 0), (1, 2)], [0], ended, failed=True)
        for ended in ("collision", OBSTACLE_COLLISION, OBSTACLE_COLLISION)
    ]
    evaluation = make.evaluation(ways, dynamic_obstacles=PATH)
    picture = draw_ways(evaluation)
    assert picture.count("<use", picture.index('id="run-into"'), picture.index('id="failures"')) == 2
    assert evaluation.summary()["endings"] == {"collision": 1, OBSTACLE_COLLISION: 2}
    assert MOVER in picture
    assert MOVER not in draw_ways(make.evaluation(ways[:1]))


def test_who_drives_by_keyboard_is_told_what_touched_the_robot(make):
    path = {"posts": 1, "radius": 0.3, "path": [[-3.0, -3.751], [-3.0, -3.749]], "speed": 1e-3}
    with closing(
        Teleop(make.config(start="fixed", collision_range=0.0, dynamic_obstacles=path).scene, seed=0)
    ) as teleop:
        assert teleop.dynamic_obstacles.shape == (1, 6)
        teleop.command = np.array([0.5, 0.0])
        for _ in range(15):
            teleop.step()
            if not teleop.command.any():
                break
        assert "CRASH WITH SOMETHING THAT MOVES (touched something that moves)" in teleop.news
