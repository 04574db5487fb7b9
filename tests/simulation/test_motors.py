"""The accelerations that the kinematic simulator assumes are those of the motors in PyBullet."""

from dataclasses import replace

import pytest

from tb2rl.core.plugins import robot_names
from tb2rl.robots.robot import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation.motors import measure_motors

ACCELERATION, COUPLING = ROBOT.wheel_acceleration, ROBOT.wheel_coupling  # [m/s^2]


@pytest.mark.parametrize("name", robot_names())
def test_the_accelerations_of_every_robot_are_those_of_its_motors(name):
    robot = find_robot(name)
    wrong = replace(robot, wheel_acceleration=1.0, wheel_coupling=-1.0)  # measured and not copied
    acceleration, coupling = measure_motors(wrong)
    assert acceleration == pytest.approx(robot.wheel_acceleration, abs=0.03)
    assert coupling == pytest.approx(robot.wheel_coupling, abs=0.03)


@pytest.mark.parametrize(("max_speed", "substeps"), [(0.7, 1), (0.71, 2), (5.0, 8)])
def test_a_fast_robot_has_substeps_and_the_same_accelerations(max_speed, substeps, make_spec):
    robot = replace(ROBOT, max_speed=max_speed)
    assert make_spec(robot=robot).substeps == substeps
    assert measure_motors(robot) == pytest.approx(measure_motors(ROBOT), abs=0.03)
