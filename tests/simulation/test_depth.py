"""The twin's depth camera sees what PyBullet's renderer draws."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.worlds import World

ROOM = World.from_shapes(
    "room",
    [(2.0, 0.0, 2.0, 6.0, 0.0)],  # its near side at x = 1 m
    [(-2.0, 0.0, 0.5)],
    start=(0.0, 0.0, 0.0),
    bounds=(-9.0, -9.0, 9.0, 9.0),
)
LENS = math.tan(ROBOT.camera.field_of_view / 2)


def views(simulation, start, width=64, height=64):
    """The depth images of a simulation's robots that begin somewhere, (num_envs, height, width)."""
    return simulation.reset(start, np.random.default_rng(0)).look(width, height)[1]


def agreement(twin, theirs):
    """The share of pixels whose depths differ by less than 2 cm, or where nothing is in both."""
    with np.errstate(invalid="ignore"):
        return float(((np.abs(twin - theirs) < 0.02) | (np.isinf(twin) & np.isinf(theirs))).mean())


@pytest.mark.parametrize(("width", "height"), [(64, 64), (40, 24)])
@pytest.mark.parametrize("name", ["loop", "round"])  # boxes alone; and a pillar, which PyBullet draws with few corners
def test_200_random_views_agree_to_2_cm_on_95_of_100_pixels(name, width, height, make_setup, make_bullet, start_at):
    spec = make_setup(name, beams=1)
    poses = spec.worlds[0].random_poses(np.random.default_rng(0), 200, ROBOT.radius)
    twin = views(KinematicSimulator(spec, 200), start_at(spec, poses), width, height)
    bullet = make_bullet(spec)
    theirs = np.concatenate([views(bullet, start_at(spec, [pose]), width, height) for pose in poses])
    assert agreement(twin, theirs) > (0.999 if name == "loop" else 0.95)
    assert 0.1 < np.isinf(twin).mean() < 0.6


def test_a_robot_on_its_way_sees_the_same_in_both(make_setup, make_bullet):
    spec = make_setup("loop", beams=1)
    twin, bullet = KinematicSimulator(spec), make_bullet(spec)
    for simulation in (twin, bullet):
        simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    shares = []
    for turn in (0.0, 0.5, -0.5) * 4:
        seen, theirs = (one.step(np.array([[0.4, turn]]), 0.2).look(64, 64)[1] for one in (twin, bullet))
        shares.append(agreement(seen, theirs))
    assert np.mean(shares) > 0.95


def test_a_wall_ahead_has_its_depth_its_height_and_the_floor_before_it(make_setup, start_at):
    spec = make_setup(ROOM, beams=1)
    (image,) = views(KinematicSimulator(spec), start_at(spec, [(0.0, 0.0, 0.0)]), 32, 32)
    away = 1.0 - ROBOT.camera.position[0]
    rises = LENS * (1.0 - (np.arange(32) + 1) / 16)  # of each row, at its lower edge
    top = away * rises > 0.5 - ROBOT.camera.position[2]
    floor = away * rises < -ROBOT.camera.position[2]
    assert np.isinf(image[top]).all()
    assert top.any()
    assert image[~top & ~floor] == pytest.approx(away)
    np.testing.assert_allclose(image[floor], np.broadcast_to((0.3 / -rises[floor])[:, None], (floor.sum(), 32)), 1e-6)


def test_depth_is_along_the_optical_axis_and_ends_at_the_cameras_range(make_setup, start_at):
    near = replace(ROBOT, camera=replace(ROBOT.camera, range=(0.05, 0.97)))
    poses = [(0.0, 0.0, 0.0), (-0.05, 0.0, 0.0)]
    for robot, seen in ((ROBOT, (0.95, 1.0)), (near, (0.95, np.inf))):
        spec = make_setup(ROOM, robot=robot, beams=1)
        images = views(KinematicSimulator(spec, 2), start_at(spec, poses), 64, 64)
        assert images[:, 30, [0, 32, 63]] == pytest.approx(np.array([[depth] * 3 for depth in seen]))


def test_each_robot_sees_the_world_that_it_is_in_and_those_that_begin_alone(make_setup, start_at):
    spec = make_setup("loop", ROOM, beams=1)
    poses, worlds = [(-3.75, -3.75, 0.0), (0.0, 0.0, 0.0), (-3.75, -3.75, 0.0)], np.array([0, 1, 0])
    twin = KinematicSimulator(spec, 3)
    robot_state = twin.reset(start_at(spec, poses, worlds), np.random.default_rng(0))
    images = robot_state.render_camera(16, 16)[1]
    assert images[1, 7, 8] == pytest.approx(0.95)
    np.testing.assert_array_equal(images[0], images[2])
    assert not np.array_equal(images[0], images[1])
    _, first = twin.restart(np.array([2]), start_at(spec, [poses[1]], np.array([1])), robot_state)
    np.testing.assert_array_equal(first.look(16, 16)[1], images[1:2])


def test_a_camera_beside_the_middle_sees_from_there_in_both(make_setup, make_bullet, start_at):
    aside = replace(ROBOT, camera=replace(ROBOT.camera, position=(0.12, 0.1, 0.2)))
    spec = make_setup("loop", robot=aside, beams=1)
    start = start_at(spec, [(-3.75, -3.75, 0.5)])
    assert agreement(views(KinematicSimulator(spec), start), views(make_bullet(spec), start)) > 0.99


def test_in_pybullet_a_reading_shows_what_the_camera_sees(make_setup, make_bullet):
    bullet = make_bullet(make_setup("loop", beams=1))
    bullet.reset(InitialState.default(bullet.spec, 1), np.random.default_rng(0))
    robot_state = bullet.step(np.array([[0.5, 1.0]]), 1.0)
    for seen, expected in zip(robot_state.render_camera(20, 16), bullet.camera(20, 16), strict=True):
        np.testing.assert_array_equal(seen, expected[None])
    assert (
        KinematicSimulator(bullet.spec).reset(robot_state.initial_state, np.random.default_rng(0)).look(20, 16)[0]
        is None
    )
