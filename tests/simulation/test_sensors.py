"""The sensors of the robot in each physics agree with its true state: odometry, laser and its noise, camera."""

import math

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT as TURTLEBOT2
from tb2rl.robots.turtlebot3 import ROBOT as BURGER

LASER_NOISE = 0.01  # [m] standard deviation of a small Hokuyo
WALL = {"boxes": [{"centre": [0, 0], "size": [0.2, 6]}]}
WANDER = [(0.5, 0.0), (0.05, 1.0), (0.05, -1.0)]  # v [m/s], w [rad/s]


def within_limits(robot, commands):
    """Commands for a TurtleBot2, scaled to the robot's top speed."""
    return np.array(commands) * (robot.max_speed / TURTLEBOT2.max_speed, 1.0)


def odometry_error(track, commands):
    """Error of the odometry [m, rad] after driving in the open."""
    track.place()
    last = track.drive(commands)[-1]
    return track.gap(last.pose, last.odometry)


@pytest.mark.parametrize("actions", ["smooth", "of a task"])
def test_odometry_agrees_with_the_true_pose_after_20_s(actions, robot, make_track):
    rng, command, commands = np.random.default_rng(0), np.zeros(2), []
    for _ in range(100):
        command = (command + rng.uniform((-0.1, -0.4), (0.1, 0.4))).clip((-0.6, -2.0), (0.6, 2.0))
        commands.append(command if actions == "smooth" else WANDER[rng.integers(3)])
    distance, turn = odometry_error(make_track(robot=robot), within_limits(robot, commands))
    assert distance < (0.02 if actions == "smooth" else 0.05)
    assert math.degrees(turn) < 3


def test_odometry_does_not_depend_on_how_often_it_is_read(make_track):
    track, ends = make_track(), []
    for times, duration in ((1, 4.0), (20, 0.2)):
        track.place()
        track.drive([(0.02 * i, 0.1 * i) for i in range(11)], 0.1)  # gently, so that no wheel slips
        ends.append(track.drive([(0.2, 1.0)] * times, duration)[-1].odometry)
    assert track.gap(*ends)[0] < 2e-3


def test_the_laser_of_a_turtlebot3_measures_all_around_from_12_cm_to_3_5_m(make_track):
    track = make_track({"boxes": [{"centre": [3, 0], "size": [0.2, 20]}]}, BURGER, beams=360)
    behind = track.place(0.5, 0.0, math.pi).ranges[0]
    assert behind[0] == pytest.approx(2.4)  # the beam of 180 degrees
    assert behind[180] == math.inf
    assert track.place(-0.7, 0.0).ranges[0, 180] == math.inf  # the wall is 3.6 m ahead
    assert track.place(2.85, 0.0).ranges[0, 180] == 0.12  # nearer than the laser can measure


def test_laser_noise_is_gaussian_independent_and_of_its_deviation(make_track):
    noisy = make_track(WALL, beams=720, noise=LASER_NOISE)
    states = [noisy.place(-1.0, seed=1), *noisy.drive([(0.0, 0.0)] * 49)]
    exact = make_track(WALL, beams=720).place(-1.0).ranges
    ranges = np.concatenate([state.ranges for state in states])
    assert (np.isinf(ranges) == np.isinf(exact)).all()
    errors = ranges[:, np.isfinite(exact[0])] - exact[:, np.isfinite(exact[0])]
    assert errors.size > 20_000
    assert abs(errors.mean()) < 5 * LASER_NOISE / math.sqrt(errors.size)
    assert errors.std() == pytest.approx(LASER_NOISE, rel=0.03)
    assert (abs(errors) < LASER_NOISE).mean() == pytest.approx(0.683, abs=0.02)
    assert abs(np.corrcoef(errors[:-1].ravel(), errors[1:].ravel())[0, 1]) < 0.03


def test_the_camera_shows_a_wall_at_its_distance_and_in_its_colour(make_track):
    track = make_track(WALL)
    rgb, depth = (images[0] for images in track.place(-2.0, 0.0, 0.3).render_camera(64, 48))
    assert (rgb.shape, rgb.dtype) == ((48, 64, 3), np.uint8)
    assert (depth.shape, depth.dtype) == ((48, 64), np.float32)
    assert depth[24, 32] == pytest.approx(1.9 / math.cos(0.3) - 0.05, abs=0.02)  # the lens: 5 cm ahead
    red, green, blue = rgb[24, 32].astype(int)
    assert red > green + 30 > blue + 30
    assert depth[0, 32] == math.inf  # over the wall


def test_camera_images_change_nothing(make_track):
    commands, states = [WANDER[i % 3] for i in range(10)], []
    track = make_track(WALL, beams=720, noise=LASER_NOISE)
    track.place(-1.5)
    expected = track.record(track.drive(commands))
    robot_state = track.place(-1.5)
    for command in commands:
        robot_state.render_camera(8, 6)
        (robot_state,) = track.drive([command])
        states.append(robot_state)
    np.testing.assert_array_equal(track.record(states), expected)
