"""The depth camera of the kinematic simulator sees what PyBullet renders."""

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.worlds import World

ROOM = World.from_shapes(
    "room",
    [(2.0, 0.0, 2.0, 6.0, 0.0)],  # its near side at x = 1 m
    [(-2.0, 0.0, 0.5)],
    start=(0.0, 0.0, 0.0),
    bounds=(-9.0, -9.0, 9.0, 9.0),
)
# More boxes than fit into a body of PyBullet.
GRID = World.from_shapes("grid", [(x, y, 0.4, 0.3, x + y) for x in range(5) for y in range(5)], start=(0.5, 0.5, 0.0))


def depth_images(simulation, initial_state, width=64, height=64):
    """Depth images at initial states, shape (num_envs, height, width)."""
    return simulation.reset(initial_state, np.random.default_rng(0)).render_camera(width, height)[1]


def agreement(kinematic, physics):
    """The share of pixels whose depths differ by less than 2 cm, or where both see nothing."""
    with np.errstate(invalid="ignore"):
        return float(((np.abs(kinematic - physics) < 0.02) | (np.isinf(kinematic) & np.isinf(physics))).mean())


@pytest.mark.parametrize(
    ("world", "width", "height", "least"),
    # Boxes; and a pillar, which PyBullet draws with few corners.
    [("loop", 64, 64, 0.999), ("round", 40, 24, 0.95), (GRID, 40, 24, 0.95)],
)
def test_random_views_agree_to_2_cm(world, width, height, least, make_spec, make_bullet, start_at):
    spec = make_spec(world, beams=1)
    poses = spec.worlds[0].sample_poses(np.random.default_rng(0).random((100, 4)), ROBOT.radius)
    kinematic = depth_images(KinematicSimulator(spec, 100), start_at(spec, poses), width, height)
    bullet = make_bullet(spec)
    physics = np.concatenate([depth_images(bullet, start_at(spec, [pose]), width, height) for pose in poses])
    assert agreement(kinematic, physics) > least
    assert 0.1 < np.isinf(kinematic).mean() < 0.7


def test_depth_is_along_the_optical_axis_and_ends_at_the_cameras_range(make_spec, start_at):
    near = replace(ROBOT, camera=replace(ROBOT.camera, range=(0.05, 0.97)))
    poses = [(0.0, 0.0, 0.0), (-0.05, 0.0, 0.0)]
    for robot, expected in ((ROBOT, (0.95, 1.0)), (near, (0.95, np.inf))):
        spec = make_spec(ROOM, robot=robot, beams=1)
        images = depth_images(KinematicSimulator(spec, 2), start_at(spec, poses))
        assert images[:, 30, [0, 32, 63]] == pytest.approx(np.array([[depth] * 3 for depth in expected]))


def test_each_camera_sees_the_world_of_its_environment_also_after_a_reset_of_some(make_spec, start_at, begin):
    spec = make_spec("loop", ROOM, beams=1)
    poses, worlds = [(-3.75, -3.75, 0.0), (0.0, 0.0, 0.0), (-3.75, -3.75, 0.0)], np.array([0, 1, 0])
    simulation = KinematicSimulator(spec, 3)
    robot_state = begin(simulation, start_at(spec, poses, worlds))
    images = robot_state.render_camera(16, 16)[1]
    assert images[1, 7, 8] == pytest.approx(0.95)
    np.testing.assert_array_equal(images[0], images[2])
    assert not np.array_equal(images[0], images[1])
    _, first = simulation.reset_at(np.array([2]), start_at(spec, [poses[1]], np.array([1])))
    np.testing.assert_array_equal(first.render_camera(16, 16)[1], images[1:2])


def test_a_camera_beside_the_centre_sees_from_there_in_both(make_spec, make_bullet, start_at):
    aside = replace(ROBOT, camera=replace(ROBOT.camera, position=(0.12, 0.1, 0.2)))
    spec = make_spec("loop", robot=aside, beams=1)
    start = start_at(spec, [(-3.75, -3.75, 0.5)])
    assert agreement(depth_images(KinematicSimulator(spec), start), depth_images(make_bullet(spec), start)) > 0.99
