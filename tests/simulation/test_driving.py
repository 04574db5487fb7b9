"""The robot in each physics reaches commanded speeds, with a plausible acceleration, and stands still at zero."""

import math

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState


@pytest.mark.parametrize("share", [-1.0, -0.077, 0.0, 0.46, 1.0])
def test_a_commanded_speed_is_reached_within_2_percent(share, robot, make_track):
    track, v = make_track(robot=robot), share * robot.max_speed
    for w in (-robot.max_turn_rate, -0.3, 0.0, 1.0, robot.max_turn_rate):
        track.place()
        before, after = track.drive([(v, w)] * 2, 1.5)
        assert np.allclose(after.twist, (v, w), rtol=0.02, atol=3e-3 * robot.max_speed)
        turned = math.remainder((after.pose - before.pose)[0, 2] - 1.5 * w, math.tau)
        assert abs(turned) <= 0.02 * 1.5 * abs(w) + 2e-3


def test_the_robot_starts_from_rest_and_accelerates_plausibly(make_track):
    track = make_track()
    assert (track.place().twist == 0).all()
    speeds = np.array([state.twist[0, 0] for state in track.drive([(0.5, 0.0)] * 50, 0.01)])
    assert speeds[1] < 0.25
    assert speeds[-1] >= 0.95 * 0.5
    assert np.diff(speeds, prepend=0).max() / 0.01 < 10  # [m/s^2]


def test_the_robot_stands_still_at_zero_velocity(robot, make_track):
    track = make_track(robot=robot)
    start = track.place(1.0, 2.0, 0.5)
    distance, turn = track.gap(track.drive([(0.0, 0.0)] * 50)[-1].pose, start.pose)
    assert distance < 1e-3
    assert math.degrees(turn) < 0.1


# ---- a robot with other parameters in one episode


def final_twist(track, command, seconds=2.0, **factors):
    """The twist (2,) after a command in an episode of a robot with its parameters times `factors`."""
    initial_state = InitialState.default(track.simulation.spec, 1)
    for name, factor in factors.items():
        initial_state.records[name] *= factor
    track.simulation.reset(initial_state, np.random.default_rng(0))
    return track.drive([command], seconds)[0].twist[0]


def test_an_episode_may_have_other_limits_and_the_next_one_has_the_robots_own(make_track):
    track = make_track()
    assert final_twist(track, (5.0, 0.0), max_speed=0.5)[0] == pytest.approx(ROBOT.max_speed / 2, rel=0.01)
    assert final_twist(track, (5.0, 0.0))[0] == pytest.approx(ROBOT.max_speed, rel=0.01)
    assert final_twist(track, (0.0, 9.0), max_turn_rate=0.3)[1] == pytest.approx(0.3 * ROBOT.max_turn_rate, rel=0.01)
    strong = final_twist(track, (5.0, 0.0), seconds=0.1)[0]
    assert final_twist(track, (5.0, 0.0), seconds=0.1, wheel_acceleration=0.5)[0] == pytest.approx(strong / 2, rel=0.05)
