"""Speeds, accelerations and commands as sensors read them are those with which the robot truly drove."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.envs.command_history import CommandHistory
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.sensors.motion import ForwardAcceleration, ForwardSpeed, LastAction, TurnRate, YawRate
from tb2rl.sensors.names import SENSORS
from tb2rl.worlds import World

PERIOD = 0.2  # [s]
OPEN = World.from_shapes("open", start=(0.0, 0.0, 0.0), bounds=(-40.0, -40.0, 40.0, 40.0))
ONE_WALL = World.from_shapes("one wall", [(1.5, 0.0, 1.0, 20.0, 0.0)], start=(0.0, 0.0, 0.0))


def values(sensor, readings):
    """What a sensor says in each of some readings of one robot, shape (readings, n)."""
    return np.concatenate([sensor.read(robot_state) for robot_state in readings])


def true_speeds(readings):
    """How far a robot drove and turned in each step, over the time of one, shape (steps, 2)."""
    moves = np.diff(np.concatenate([robot_state.pose for robot_state in readings]), axis=0)
    turns = np.remainder(moves[:, 2] + math.pi, math.tau) - math.pi
    return np.column_stack([np.hypot(moves[:, 0], moves[:, 1]), turns]) / PERIOD


@pytest.mark.parametrize("told", [(0.5, 0.0), (0.3, 0.8), (0.05, -1.0)])
def test_speeds_are_those_of_a_robot_that_drives_on(told, drive):
    readings = drive(OPEN, (0, 0, 0.4), [told] * 10)
    speed, turn, yaw = (values(kind(ROBOT), readings)[-5:, 0] for kind in (ForwardSpeed, TurnRate, YawRate))
    v, w = true_speeds(readings)[-5:].T
    np.testing.assert_allclose(speed, v, atol=0.01)
    np.testing.assert_allclose(turn, w, atol=0.03)
    np.testing.assert_allclose(yaw, w, atol=0.03)


def test_an_acceleration_is_the_mean_one_since_the_last_reading(drive):
    readings = drive(OPEN, (0, 0, 0.4), [(0.5, 0.0)] * 4 + [(0.2, 0.0)] * 4 + [(-0.2, 0.5)] * 4)
    felt, speed = (
        values(ForwardAcceleration(ROBOT), readings)[:, 0],
        [robot_state.twist[0, 0] for robot_state in readings],
    )
    assert felt[0] == 0.0
    np.testing.assert_allclose(felt[1:] * PERIOD, np.diff(speed), atol=1e-12)
    assert felt[[1, 5]] == pytest.approx([2.5, -1.5], abs=0.1)  # both are over within a step
    assert felt[[3, 4, 8]] == pytest.approx(0.0, abs=0.05)


def test_against_a_wall_the_wheels_turn_on(drive):
    last = drive(ONE_WALL, (0, 0, 0), [(0.5, 0.0)] * 10)[-1]
    assert ForwardSpeed(ROBOT).read(last)[0, 0] > 0.3
    assert last.bumped[0]


def test_the_last_actions_are_what_was_told_as_shares_of_the_fastest(make_reading):
    one, other, sensor = [(0.65, 0.0), (0.13, math.pi)], [(0.0, -math.pi), (-0.65, 0.0)], LastAction(ROBOT, count=3)
    history, robot_state = CommandHistory(sensor.reads_commands, delayed=False), make_reading(twist=np.zeros((2, 2)))
    history.reset(robot_state)
    for commands in np.transpose([one, other], (1, 0, 2)):
        history.push(commands)
    shares = sensor.read(replace(robot_state, command_history=history))
    np.testing.assert_allclose(shares, [[0.2, 1.0, 1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, -1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(LastAction(ROBOT).read(replace(robot_state, command_history=history)), shares[:, :2])
    np.testing.assert_array_equal(sensor.read(robot_state), np.zeros((2, 6)), "nothing was told yet")


@pytest.mark.parametrize(
    ("kind", "unit", "largest"),
    [
        (ForwardSpeed, "m/s", 0.65),
        (TurnRate, "rad/s", math.pi),
        (YawRate, "rad/s", math.pi),
        (ForwardAcceleration, "m/s^2", 2.999),
    ],
)
def test_they_say_their_units_limits_and_classes(kind, unit, largest):
    sensor = kind(ROBOT, (-0.5, 0.2))
    assert (sensor.unit, sensor.shape, sensor.low) == (unit, (1,), -sensor.high)
    assert sensor.high == pytest.approx(largest)
    assert sensor.bins == pytest.approx((-0.5 * largest, 0.2 * largest))


def test_each_robot_reads_its_own(make_reading):
    robot_state = make_reading(
        odometry_twist=np.array([[0.1, 0.2], [0.3, 0.4]]),
        twist=[(0.0, 0.5), (0.0, 0.6)],
        acceleration=np.array([1.0, -2.0]),
    )
    assert ForwardSpeed(ROBOT).read(robot_state).tolist() == [[0.1], [0.3]]
    assert TurnRate(ROBOT).read(robot_state).tolist() == [[0.2], [0.4]]
    assert YawRate(ROBOT).read(robot_state).tolist() == [[0.5], [0.6]]
    assert ForwardAcceleration(ROBOT).read(robot_state).tolist() == [[1.0], [-2.0]]


@pytest.mark.parametrize("name", sorted(set(SENSORS) - {"camera"}))
def test_every_sensor_has_classes(name, make_setup):
    for kind in SENSORS[name]:
        own = {"bins": (1.0,)} if name == "laser" else {}
        sensor = kind(**kind.given(make_setup()), **own)
        assert len(sensor.bins) > 0
        assert (np.diff(sensor.bins) > 0).all()
        assert sensor.low < min(sensor.bins)
        assert max(sensor.bins) < sensor.high
