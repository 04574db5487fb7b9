"""The scene view shows one world at a time, the robot where it is placed, and a disc for a goal."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

scene_view = pytest.importorskip("tb2rl.viz.scene_view", reason="PyBullet is not installed")

SIDES = 160, 90  # [px]
NO_GOAL = np.full(2, np.nan)


@pytest.fixture
def view(make_spec) -> Iterator[scene_view.SceneView]:
    """The worlds `wall` and `loop`, and the TurtleBot2."""
    with closing(scene_view.SceneView(make_spec("wall", "loop"))) as view:
        yield view


def seen(view: scene_view.SceneView, world: int, goal: np.ndarray, pose: tuple[float, float, float]) -> np.ndarray:
    view.show(world, goal, np.array(pose))
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


def test_a_goal_is_a_green_disc_that_appears_moves_and_disappears(view, green):
    goals = NO_GOAL, (1.2, 0.5), (1.2, -0.5), NO_GOAL
    before, left, right, after = (green(seen(view, 0, np.array(goal), (0.0, 0.0, 0.0))) for goal in goals)
    without = len(before)
    assert min(len(left), len(right)) > without + 10
    assert left[:, 1].min() < 60
    assert right[:, 1].max() > 100
    assert len(after) == without


def test_worlds_alternate(view):
    pose = (0.0, 3.9, 0.0)  # free in both
    wall, loop, again = (seen(view, world, NO_GOAL, pose) for world in (0, 1, 0))
    assert (wall == again).all()
    assert np.abs(wall - loop).max() > 100


def test_the_floor_has_fixed_tiles_of_a_metre():
    here, two_tiles_on, one_tile_on = (
        scene_view.draw_floor((x, y, 0.5), *SIDES) for x, y in ((0.3, 0.2), (2.3, -1.8), (1.3, 0.2))
    )
    assert (here.shape, here.dtype) == ((*SIDES[::-1], 3), np.uint8)
    assert (here != two_tiles_on).any(axis=2).mean() < 0.001, "up to rounding"
    assert (here != one_tile_on).any(axis=2).mean() > 0.3
