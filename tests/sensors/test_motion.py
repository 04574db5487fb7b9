"""Speeds, accelerations and commands of sensors are those of the true motion."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.envs.episode_state import CommandHistory
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.sensors.motion import ForwardAcceleration, ForwardSpeed, LastAction, TurnRate, YawRate
from tb2rl.worlds import World

PERIOD = 0.2  # [s]
OPEN = World.from_shapes("open", start=(0.0, 0.0, 0.0), bounds=(-40.0, -40.0, 40.0, 40.0))
ONE_WALL = World.from_shapes("one wall", [(1.5, 0.0, 1.0, 20.0, 0.0)], start=(0.0, 0.0, 0.0))


def values(sensor, robot_states):
    """The values of a sensor in some robot states of one environment, shape (steps, n)."""
    return np.concatenate([sensor.read(robot_state) for robot_state in robot_states])


def true_speeds(robot_states):
    """How far a robot drove and turned in each step, over the time of one, shape (steps, 2)."""
    moves = np.diff(np.concatenate([robot_state.pose for robot_state in robot_states]), axis=0)
    turns = np.remainder(moves[:, 2] + math.pi, math.tau) - math.pi
    return np.column_stack([np.hypot(moves[:, 0], moves[:, 1]), turns]) / PERIOD


@pytest.mark.parametrize("command", [(0.5, 0.0), (0.3, 0.8), (0.05, -1.0)])
def test_speeds_are_those_of_a_robot_that_drives_on(command, drive):
    robot_states = drive(OPEN, (0, 0, 0.4), [command] * 10)
    speed, turn, yaw = (values(kind(ROBOT), robot_states)[-5:, 0] for kind in (ForwardSpeed, TurnRate, YawRate))
    v, w = true_speeds(robot_states)[-5:].T
    np.testing.assert_allclose(speed, v, atol=0.01)
    np.testing.assert_allclose(turn, w, atol=0.03)
    np.testing.assert_allclose(yaw, w, atol=0.03)


def test_an_acceleration_is_the_mean_one_since_the_last_robot_state(drive):
    robot_states = drive(OPEN, (0, 0, 0.4), [(0.5, 0.0)] * 4 + [(0.2, 0.0)] * 4 + [(-0.2, 0.5)] * 4)
    felt, speed = (
        values(ForwardAcceleration(ROBOT), robot_states)[:, 0],
        [robot_state.twist[0, 0] for robot_state in robot_states],
    )
    assert felt[0] == 0.0
    np.testing.assert_allclose(felt[1:] * PERIOD, np.diff(speed), atol=1e-12)
    assert felt[[1, 5]] == pytest.approx([2.5, -1.5], abs=0.1)  # both are over within a step
    assert felt[[3, 4, 8]] == pytest.approx(0.0, abs=0.05)


def test_against_a_wall_the_wheels_turn_on(drive):
    last = drive(ONE_WALL, (0, 0, 0), [(0.5, 0.0)] * 10)[-1]
    assert ForwardSpeed(ROBOT).read(last)[0, 0] > 0.3
    assert last.bumped[0]


def test_the_last_actions_are_commands_as_shares_of_the_largest(make_robot_state):
    one, other, sensor = [(0.65, 0.0), (0.13, math.pi)], [(0.0, -math.pi), (-0.65, 0.0)], LastAction(ROBOT, count=3)
    history, robot_state = CommandHistory(sensor.command_history_length), make_robot_state(twist=np.zeros((2, 2)))
    history.reset(robot_state)
    for commands in np.transpose([one, other], (1, 0, 2)):
        history.update(robot_state, commands)
    shares = sensor.read(replace(robot_state, command_history=history))
    np.testing.assert_allclose(shares, [[0.2, 1.0, 1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, -1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(LastAction(ROBOT).read(replace(robot_state, command_history=history)), shares[:, :2])
    np.testing.assert_array_equal(sensor.read(robot_state), np.zeros((2, 6)), "there was no command yet")


def test_bins_are_shares_of_the_largest_value():
    sensor = ForwardSpeed(ROBOT, (-0.5, 0.2))
    assert (sensor.unit, sensor.low, sensor.high) == ("m/s", -0.65, 0.65)
    assert sensor.bins == pytest.approx((-0.325, 0.13))
    assert ForwardAcceleration(ROBOT).high == pytest.approx(2.999)
