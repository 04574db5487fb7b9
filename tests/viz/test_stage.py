"""The stage shows one world at a time, a robot where it is put, and a disc for a goal; its process starts quickly."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.simulation.bullet.client import pybullet
from tb2rl.viz.floor import draw_floor
from tb2rl.viz.stage import Stage, _coloured_shell
from tb2rl.worlds.registry import find_world

SIDES = 160, 90  # [px]
NO_GOAL = np.full(2, np.nan)


@pytest.fixture
def stage(make) -> Iterator[Stage]:
    """The worlds `wall` and `loop`, and the TurtleBot2."""
    spec = replace(make.config("wall").scene.spec, worlds=(find_world("wall"), find_world("loop")))
    with closing(Stage(spec)) as stage:
        yield stage


def seen(stage: Stage, world: int, goal: np.ndarray, pose: tuple[float, float, float]) -> np.ndarray:
    stage.begin(world, goal)
    stage.place(np.array(pose))
    return stage.chase(*SIDES).astype(int)


def test_the_robot_stands_before_the_camera_wherever_it_is_put(stage):
    pictures = [seen(stage, 0, NO_GOAL, pose) for pose in ((0.0, 0.0, 0.0), (4.5, 2.0, 1.0))]
    for picture in pictures:
        assert picture.shape == (*SIDES[::-1], 3)
        assert picture[62, 80].max() < 90, "the robot"
        assert picture[88, 80].min() > 180, "the floor"
    assert (pictures[0] != pictures[1]).any()


def test_the_window_has_a_link_for_each_shape_of_the_robot_so_that_each_has_its_colour(stage):
    """The window gives a link one colour; the camera's renderer does not, and sees no difference."""
    pose = (1.0, 0.5, 0.7)
    before, shapes = seen(stage, 0, NO_GOAL, pose), pybullet.getVisualShapeData(stage._robot.body, 0, stage._client)
    stage._shell = _coloured_shell(stage._client, stage._robot)
    assert pybullet.getNumJoints(stage._shell, stage._client) == len(shapes) == 14
    assert len({shape[7] for shape in shapes}) > 2
    assert (abs(seen(stage, 0, NO_GOAL, pose) - before) > 8).mean() < 0.002, "edges, by the rounding of places"
    pybullet.removeBody(stage._shell, stage._client)
    stage._shell = -1
    assert seen(stage, 0, NO_GOAL, pose)[62, 80].max() > 90, "the robot itself is hidden"


def test_a_goal_is_a_green_disc_that_comes_moves_and_goes(stage):
    def green(goal) -> np.ndarray:
        picture = seen(stage, 0, np.array(goal), (0.0, 0.0, 0.0))
        greenish = (picture[..., 1] - picture[..., 0] > 30) & (picture[..., 1] - picture[..., 2] > 30)
        return np.argwhere(greenish)

    without = len(green(NO_GOAL))
    left, right = green((1.2, 0.5)), green((1.2, -0.5))
    assert min(len(left), len(right)) > without + 10
    assert left[:, 1].min() < 60
    assert right[:, 1].max() > 100
    assert len(green(NO_GOAL)) == without


def test_worlds_take_turns(stage):
    pose = (0.0, 3.9, 0.0)  # free in both
    wall, loop, again = (seen(stage, world, NO_GOAL, pose) for world in (0, 1, 0))
    assert (wall == again).all()
    assert np.abs(wall - loop).max() > 100


def test_the_robot_stays_where_it_is_put_even_in_a_wall(stage):
    picture = seen(stage, 0, NO_GOAL, (2.5, 0.0, 0.0))
    assert (stage.chase(*SIDES) == picture).all()


def test_a_stage_can_be_closed_twice(stage):
    assert stage.is_open
    stage.close()
    stage.close()
    assert not stage.is_open


def test_the_windows_process_imports_no_learners():
    names = "('torch', 'stable_baselines3')"
    code = f"import sys, tb2rl.viz.stage; print([name for name in sys.modules if name in {names}])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_floor_has_tiles_of_a_metre_that_stay_where_they_are():
    here = draw_floor((0.3, 0.2, 0.5), *SIDES)
    assert (here.shape, here.dtype) == ((*SIDES[::-1], 3), np.uint8)
    assert len(np.unique(here[80])) > 1
    two_further = draw_floor((2.3, -1.8, 0.5), *SIDES)
    one_further = draw_floor((1.3, 0.2, 0.5), *SIDES)
    assert (here != two_further).any(axis=2).mean() < 0.001, "rounding aside"
    assert (here != one_further).any(axis=2).mean() > 0.3
