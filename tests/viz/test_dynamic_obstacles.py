"""Dynamic obstacles are visible: in films by both cameras, in plans, in pictures of paths, and in the report."""

from contextlib import closing

import numpy as np
import pytest

from tb2rl.rendering.above import draw_floor_plan
from tb2rl.rendering.colours import DYNAMIC_OBSTACLE, ROUTE
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.tasks.task import DYNAMIC_COLLISION
from tb2rl.viz.cameras import CAMERAS, beam_ranges
from tb2rl.viz.charts import draw_episodes
from tb2rl.viz.pictures import draw_paths
from tb2rl.worlds.dynamic_obstacles import parse_dynamic_obstacles
from tb2rl.worlds.world import World

LOOP = {"posts": 1, "path": [[-3, 3], [3, 3], [3, -3]]}
POST = {"posts": 1, "radius": 0.3, "path": [[-2.0, -3.751], [-2.0, -3.749]], "speed": 1e-3}  # it hardly moves


def purple(picture: np.ndarray) -> int:
    """Number of pixels with the hue of dynamic obstacles, in any light."""
    red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
    return int(((blue - green > 25) & (blue > red + 10)).sum())


def test_the_camera_from_above_shows_them_at_each_instant(make, coloured):
    config = make.config(start="fixed", beams=5, dynamic_obstacles={"boxes": 1, "size": [1.0, 0.6]})
    frames, scene = make.frames(make.policy(1), config, steps=5)
    x0, _, x1, y1 = scene.world.bounds
    with closing(CAMERAS["above"](scene)) as camera:
        shown = [(frame, camera.picture(frame)) for frame in frames[:10:9]]
    positions = []
    for frame, picture in shown:
        rows, columns = coloured(picture, DYNAMIC_OBSTACLE).T
        scale = picture.shape[1] / (x1 - x0 + 0.6)
        positions.append(((columns.mean() + 0.5) / scale + x0 - 0.3, y1 + 0.3 - (rows.mean() + 0.5) / scale))
        assert positions[-1] == pytest.approx(frame.dynamic_obstacles[0, :2], abs=0.03)
        assert len(rows) == pytest.approx(0.6 * scale**2, rel=0.06), "no beam is drawn over it"
    assert np.hypot(*np.subtract(positions[-1], positions[0])) > 0.3


def test_beams_end_at_them(make):
    config = make.config(start="fixed", beams=3, dynamic_obstacles=POST | {"radius": 0.4})
    frames, scene = make.frames(make.policy(1), config)
    assert beam_ranges(frames[0], scene.world, scene)[1] == pytest.approx(3.75 - 2.0 - 0.4, abs=1e-3)


@pytest.mark.bullet
def test_the_chase_camera_shows_them(make):
    seen = []
    for settings in (POST, None):
        frames, scene = make.frames(make.policy(1), make.config(start="fixed", dynamic_obstacles=settings))
        with closing(CAMERAS["chase"](scene)) as camera:
            seen.append(purple(camera.picture(frames[0])))
    assert seen[0] > 300
    assert seen[1] < 20


def test_plans_and_pictures_of_paths_show_their_routes(make, coloured):
    obstacles = parse_dynamic_obstacles(LOOP, "dynamic_obstacles")
    world = World.from_shapes("hall", start=(0, 0, 0), bounds=(-5, -5, 5, 5), dynamic_obstacles=obstacles)
    picture = draw_floor_plan(world, ROBOT)
    scale = picture.shape[1] / 10.6
    rows, columns = coloured(picture, ROUTE).T
    assert columns.min() / scale - 5.3 == pytest.approx(-3.0, abs=0.1)
    assert 5.3 - rows.min() / scale == pytest.approx(3.0, abs=0.1)
    episodes = [make.episode(np.zeros((2, 2)), [0])]
    scenes = [make.config("maze", dynamic_obstacles=settings).scene for settings in ([LOOP, {"people": 1}], None)]
    crowded, empty = (len(coloured(draw_paths(scene, episodes), ROUTE)) for scene in scenes)
    assert crowded > 500
    assert empty == 0


def test_the_report_marks_collisions_with_them(make):
    endings = ("collision", DYNAMIC_COLLISION, DYNAMIC_COLLISION)
    episodes = [make.episode([(0, 0), (1, 2)], [0], ended, failed=True) for ended in endings]
    picture = draw_episodes(make.evaluation(episodes, dynamic_obstacles=LOOP))
    assert picture.count("<use", picture.index('id="dynamic-collisions"'), picture.index('id="failures"')) == 2
    assert DYNAMIC_OBSTACLE in picture
    assert DYNAMIC_OBSTACLE not in draw_episodes(make.evaluation(episodes[:1]))
