"""The robot in PyBullet reaches the speeds that it is told, as fast as a robot would, and stands still when told to."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.robots.robot import MAX_SPEED, MAX_TURN_RATE, RADIUS, WHEEL_ACCELERATION, WHEEL_SEPARATION
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState

REACH = ROBOT.wheel_separation / 2  # [m]


@pytest.mark.parametrize("share", [-1.0, -0.46, -0.077, 0.0, 0.077, 0.77, 1.0])
def test_a_commanded_speed_is_reached_within_2_percent(share, robot, make_track):
    track, v = make_track(robot=robot), share * robot.max_speed
    for w in (-robot.max_turn_rate, -1.0, -0.3, 0.0, 0.3, 1.0, robot.max_turn_rate):
        track.place()
        before, after = track.drive([(v, w)] * 2, 1.5)
        assert np.allclose(after.twist, (v, w), rtol=0.02, atol=3e-3 * robot.max_speed)
        turned = math.remainder((after.pose - before.pose)[0, 2] - 1.5 * w, math.tau)
        assert abs(turned) <= 0.02 * 1.5 * abs(w) + 2e-3


@pytest.mark.parametrize(
    ("command", "left", "right"),
    [
        ((0.35, 0.0), 10.0, 10.0),
        ((-0.35, 0.0), -10.0, -10.0),
        ((0.0, 1.0), -0.115 / 0.035, 0.115 / 0.035),  # to the left: the right wheel forward
        ((0.115, -1.0), 0.23 / 0.035, 0.0),  # around the right wheel
    ],
)
def test_the_wheels_turn_as_those_of_a_differential_drive(command, left, right, make_track):
    track = make_track()
    track.place()
    track.drive([command], 2.0)
    rates = [rate for _, rate in track.simulation.state()["wheels"]]
    assert rates == pytest.approx([left, right], rel=0.01, abs=0.02)  # [rad/s]


@pytest.mark.parametrize("duration", [0.01, 0.05, 0.07, 0.2, 1.0])
def test_a_step_lasts_as_long_as_it_was_asked_to(duration, make_track):
    track = make_track()
    track.place()
    before, after = track.drive([(0.5, 0.0)], 1.0)[0], track.drive([(0.5, 0.0)], duration)[0]
    assert track.gap(after.pose, before.pose)[0] == pytest.approx(0.5 * duration, rel=0.01)


def test_commands_beyond_the_limits_are_cut(make_track):
    track = make_track()
    track.place()
    ahead, spinning = np.array([[ROBOT.max_speed, 0]]), np.array([[0, -ROBOT.max_turn_rate]])
    assert track.drive([(5.0, 0.0)], 2.0)[-1].twist == pytest.approx(ahead, abs=0.01)
    assert track.drive([(0.0, -50.0)], 3.0)[-1].twist == pytest.approx(spinning, abs=0.01)


def test_it_starts_from_rest_and_gains_speed_as_a_robot_would(make_track):
    track = make_track()
    assert (track.place().twist == 0).all()
    speeds = np.array([robot_state.twist[0, 0] for robot_state in track.drive([(0.5, 0.0)] * 50, 0.01)])
    assert speeds[1] < 0.25
    assert speeds[-1] >= 0.95 * 0.5
    assert np.diff(speeds, prepend=0).max() / 0.01 < 10  # [m/s^2]


def test_it_stands_still_when_told_to(robot, make_track):
    track = make_track(robot=robot)
    start = track.place(1.0, 2.0, 0.5)
    distance, turn = track.gap(track.drive([(0.0, 0.0)] * 50)[-1].pose, start.pose)
    assert distance < 1e-3
    assert math.degrees(turn) < 0.1


# ---- a robot that is different in one episode


def varied(track, column, factor):
    """The reading after one step ahead of a robot with one of its parameters times `factor`, and after 2 s more."""
    start = InitialState.default(track.simulation.spec, 1)
    start.parameters[:, column] *= factor
    track.simulation.reset(start, np.random.default_rng(0))
    return track.drive([(5.0, 0.0)], 0.1)[0], track.drive([(5.0, 0.0)], 2.0)[0]


def test_an_episode_may_have_another_top_speed_and_the_next_one_the_robots_own(make_track):
    track = make_track()
    assert varied(track, MAX_SPEED, 0.5)[1].twist[0, 0] == pytest.approx(ROBOT.max_speed / 2, rel=0.01)
    assert varied(track, MAX_SPEED, 1.0)[1].twist[0, 0] == pytest.approx(ROBOT.max_speed, rel=0.01)


def test_an_episode_may_have_another_largest_turn_rate(make_track):
    track = make_track()
    start = InitialState.default(track.simulation.spec, 1)
    start.parameters[:, MAX_TURN_RATE] = 1.0
    track.simulation.reset(start, np.random.default_rng(0))
    assert track.drive([(0.0, 9.0)], 2.0)[0].twist[0, 1] == pytest.approx(1.0, rel=0.01)


def test_an_episode_may_have_weaker_motors(make_track):
    track = make_track()
    weak, strong = (varied(track, WHEEL_ACCELERATION, factor)[0].twist[0, 0] for factor in (0.5, 1.0))
    assert weak == pytest.approx(strong / 2, rel=0.05)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_an_episode_may_have_another_wheel_separation_of_which_the_robot_knows(factor, make_track):
    track = make_track()
    start = InitialState.default(track.simulation.spec, 1)
    start.parameters[:, WHEEL_SEPARATION] *= factor
    track.simulation.reset(start, np.random.default_rng(0))
    after = track.drive([(0.2, 1.0)], 2.0)[0]
    assert after.twist[0] == pytest.approx([0.2, 1.0], rel=0.02)
    assert after.odometry[0, 2] == pytest.approx(after.pose[0, 2], rel=0.01)


def test_a_radius_other_than_the_urdfs_is_refused(make_track):
    with pytest.raises(InputError, match="radius from its URDF"):
        varied(make_track(), RADIUS, 1.1)


def test_a_robot_of_other_limits_keeps_them(make_setup, make_bullet):
    spec = make_setup(robot=replace(ROBOT, max_speed=0.2))
    simulation = make_bullet(spec)
    simulation.reset(InitialState.default(spec, 1), np.random.default_rng(0))
    assert simulation.step(np.array([[1.0, 0.0]]), 2.0).twist[0, 0] == pytest.approx(0.2, rel=0.01)
