"""What the twin needs to know of a robot's motors is what they do in PyBullet."""

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.plugins import robot_names
from tb2rl.robots.registry import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation.bullet.motors import measure_motors
from tb2rl.simulation.spec import PHYSICS_RATE

FASTEST, COUPLED = ROBOT.wheel_acceleration, ROBOT.wheel_coupling  # [m/s^2]


@pytest.mark.parametrize("name", robot_names())
def test_every_robots_numbers_are_what_its_motors_do(name):
    robot = find_robot(name)
    acceleration, coupling = measure_motors(robot)
    assert acceleration == pytest.approx(robot.wheel_acceleration, abs=0.03)
    assert coupling == pytest.approx(robot.wheel_coupling, abs=0.03)


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ((0.6, 0.0), (FASTEST + COUPLED, FASTEST + COUPLED)),
        ((0.0, 3.0), (-FASTEST + COUPLED, FASTEST - COUPLED)),
        ((0.3, 0.6 / ROBOT.wheel_separation), (0.0, FASTEST)),
    ],
)
def test_the_rims_speed_up_in_pybullet_as_the_numbers_say(told, expected, make_track):
    track = make_track()
    track.place()
    v, w = np.concatenate([robot_state.twist for robot_state in track.drive([told] * 6, 1 / PHYSICS_RATE)]).T
    wheel_speeds = np.stack([v - w * ROBOT.wheel_separation / 2, v + w * ROBOT.wheel_separation / 2], axis=1)
    np.testing.assert_allclose((wheel_speeds[5] - wheel_speeds[0]) / 5 * PHYSICS_RATE, expected, atol=0.03)


def test_the_numbers_are_measured_and_not_believed():
    wrong = replace(ROBOT, wheel_acceleration=1.0, wheel_coupling=-1.0, max_speed=0.01, max_turn_rate=0.01)
    assert measure_motors(wrong) == pytest.approx(measure_motors(ROBOT), abs=1e-6)


@pytest.mark.parametrize(("max_speed", "parts"), [(0.22, 1), (0.7, 1), (0.71, 2), (1.4, 2), (2.0, 4), (5.0, 8)])
def test_a_fast_robot_has_its_physics_in_finer_steps_and_its_motors_push_as_before(max_speed, parts, make_setup):
    robot = replace(ROBOT, max_speed=max_speed)
    assert make_setup(robot=robot).substeps == parts
    assert measure_motors(robot) == pytest.approx(measure_motors(ROBOT), abs=0.03)


def test_half_the_torque_accelerates_half_as_much():
    acceleration, _ = measure_motors(replace(ROBOT, wheel_torque=ROBOT.wheel_torque / 2))
    assert acceleration == pytest.approx(ROBOT.wheel_acceleration / 2, rel=0.05)
