"""The top view shows the robot in its size, its beams, its path and its goal."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.rendering.above import GOAL_RADIUS, WorldPicture
from tb2rl.rendering.colours import BEAM, BODY, GOAL, NOSE, PATH, WHEEL
from tb2rl.robots import Laser
from tb2rl.robots.turtlebot2 import ROBOT

ONE_BEAM = Laser(beams=1)


def draw(world, robot=ROBOT, laser=ONE_BEAM, goal=None, pose=(0.0, 0.0, 0.0), ranges=(0.1,), path=()):
    picture = WorldPicture(world, robot, laser, goal)
    return picture.draw(np.array(pose), np.array(ranges), [np.array(point) for point in path])


def test_a_large_robot_has_its_size(square, look_at):
    robot = replace(ROBOT, radius=3 * ROBOT.radius, wheel_separation=3 * ROBOT.wheel_separation)
    look = look_at(square, draw(square, robot, pose=(-0.5, -0.2, 0.0)))
    body = look.points(BODY)
    (left, low), (right, high) = body.min(axis=0), body.max(axis=0)
    drawn = (right - left) / 2, (high - low) / 2
    assert drawn == pytest.approx((robot.radius, robot.radius), abs=0.02)
    assert ((left + right) / 2, (low + high) / 2) == pytest.approx((-0.5, -0.2), abs=0.02)
    wheels = look.points(WHEEL)[:, 1]
    assert wheels.max() - wheels.min() == pytest.approx(robot.wheel_separation + 0.03, abs=0.02)


@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_the_nose_points_ahead(yaw, square, look_at):
    x, y = look_at(square, draw(square, pose=(0.0, 0.0, yaw))).points(NOSE).mean(axis=0)
    assert math.remainder(math.atan2(y, x) - yaw, math.tau) == pytest.approx(0.0, abs=0.05)
    assert math.hypot(x, y) == pytest.approx(0.47 * ROBOT.radius, abs=0.02)


def test_beams_are_as_long_as_their_ranges_up_to_the_lasers_maximum(square, look_at):
    laser = Laser(beams=3, max_range=1.5)
    look = look_at(square, draw(square, laser=laser, pose=(0.0, -0.3, 0.0), ranges=(0.8, math.inf, 1.2)))
    beams = look.points(BEAM)
    assert beams[:, 1].min() == pytest.approx(-0.3 - 0.8, abs=0.03), "right"
    assert beams[:, 0].max() == pytest.approx(1.5, abs=0.03), "ahead"
    assert beams[:, 1].max() == pytest.approx(-0.3 + 1.2, abs=0.03), "left"


def test_the_path_is_drawn_through_its_points(square, look_at):
    path = [(-1.5, 1.5, 0.0), (-0.5, 1.5, 0.0), (-0.5, 1.0, 0.0)]
    look = look_at(square, draw(square, path=path))
    for x, y in [(-1.4, 1.5), (-1.0, 1.5), (-0.5, 1.3)]:
        assert look.is_at(PATH, x, y)
    assert not len(look_at(square, draw(square, path=path[:1])).points(PATH)), "a point is not a path yet"


def test_a_goal_has_a_ring_around_it(square, look_at):
    for none in (None, np.full(2, math.nan)):
        assert (draw(square, goal=none) == draw(square)).all()
    ring = look_at(square, draw(square, goal=(-1.0, 1.0))).points(GOAL)
    ring = ring[ring[:, 1] > 0.5]  # the nose has the same colour
    assert ring.mean(axis=0) == pytest.approx((-1.0, 1.0), abs=0.02)
    distances = np.hypot(*(ring - (-1.0, 1.0)).T)
    assert distances.max() == pytest.approx(GOAL_RADIUS, abs=0.02)
    assert distances.min() > GOAL_RADIUS - 0.03, "the ring is empty"


def test_a_picture_leaves_no_trace_on_the_next_one(square):
    picture = WorldPicture(square, ROBOT, ONE_BEAM)
    first = picture.draw(np.zeros(3), np.ones(1), [])
    picture.draw(np.array([-1.0, 1.0, 0.0]), np.ones(1), [np.zeros(3), np.ones(3)])
    assert (picture.draw(np.zeros(3), np.ones(1), []) == first).all()
