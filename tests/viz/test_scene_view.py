"""The scene view shows one world at a time, the robot where it is placed, and a disc for a goal."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from tb2rl.simulation.bullet.client import pybullet
from tb2rl.viz.scene_view import SceneView, _add_coloured_robot, draw_floor

SIDES = 160, 90  # [px]
NO_GOAL = np.full(2, np.nan)


@pytest.fixture
def view(make_spec) -> Iterator[SceneView]:
    """The worlds `wall` and `loop`, and the TurtleBot2."""
    with closing(SceneView(make_spec("wall", "loop"))) as view:
        yield view


def seen(view: SceneView, world: int, goal: np.ndarray, pose: tuple[float, float, float]) -> np.ndarray:
    view.show_world(world, goal)
    view.place(np.array(pose))
    return view.chase_picture(*SIDES).astype(int)


def test_the_robot_stands_before_the_camera_wherever_it_is_placed(view):
    poses = ((0.0, 0.0, 0.0), (4.5, 2.0, 1.0), (2.5, 0.0, 0.0))  # the last one in a wall, which does not move it
    pictures = [seen(view, 0, NO_GOAL, pose) for pose in poses]
    for picture in pictures[:2]:
        assert picture.shape == (*SIDES[::-1], 3)
        assert picture[62, 80].max() < 90, "the robot"
        assert picture[88, 80].min() > 180, "the floor"
    assert (pictures[0] != pictures[1]).any()
    assert (view.chase_picture(*SIDES) == pictures[2]).all()


def test_the_coloured_robot_has_a_link_for_each_shape(view):
    """PyBullet's window gives a link one colour; the camera's renderer shows no difference."""
    pose = (1.0, 0.5, 0.7)
    before, shapes = seen(view, 0, NO_GOAL, pose), pybullet.getVisualShapeData(view._robot.body, 0, view._client)
    view._coloured_robot = _add_coloured_robot(view._client, view._robot)
    assert pybullet.getNumJoints(view._coloured_robot, view._client) == len(shapes) == 14
    assert len({shape[7] for shape in shapes}) > 2
    assert (abs(seen(view, 0, NO_GOAL, pose) - before) > 8).mean() < 0.002, "edges differ by rounding"
    pybullet.removeBody(view._coloured_robot, view._client)
    view._coloured_robot = -1
    assert seen(view, 0, NO_GOAL, pose)[62, 80].max() > 90, "the robot itself is hidden"


def test_a_goal_is_a_green_disc_that_appears_moves_and_disappears(view):
    def green(goal) -> np.ndarray:
        picture = seen(view, 0, np.array(goal), (0.0, 0.0, 0.0))
        return np.argwhere((picture[..., 1] - picture[..., 0] > 30) & (picture[..., 1] - picture[..., 2] > 30))

    without = len(green(NO_GOAL))
    left, right = green((1.2, 0.5)), green((1.2, -0.5))
    assert min(len(left), len(right)) > without + 10
    assert left[:, 1].min() < 60
    assert right[:, 1].max() > 100
    assert len(green(NO_GOAL)) == without


@pytest.mark.slow
def test_the_windows_process_imports_no_learners():
    code = "import sys, tb2rl.viz.scene_view; sys.exit(bool({'torch', 'stable_baselines3'} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_worlds_alternate_and_a_view_can_be_closed_twice(view):
    pose = (0.0, 3.9, 0.0)  # free in both
    wall, loop, again = (seen(view, world, NO_GOAL, pose) for world in (0, 1, 0))
    assert (wall == again).all()
    assert np.abs(wall - loop).max() > 100
    assert view.is_open
    view.close()
    view.close()
    assert not view.is_open


def test_the_floor_has_fixed_tiles_of_a_metre():
    here, two_tiles_on, one_tile_on = (
        draw_floor((x, y, 0.5), *SIDES) for x, y in ((0.3, 0.2), (2.3, -1.8), (1.3, 0.2))
    )
    assert (here.shape, here.dtype) == ((*SIDES[::-1], 3), np.uint8)
    assert (here != two_tiles_on).any(axis=2).mean() < 0.001, "up to rounding"
    assert (here != one_tile_on).any(axis=2).mean() > 0.3
