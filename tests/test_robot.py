"""The robot's numbers: the URDF that the physics reads must state the same ones."""

import math
from xml.etree import ElementTree

import numpy as np
import pytest

from tb2rl import robot
from tb2rl.settings import read_yaml, room
from tb2rl.simulation.bullet import URDF

MODEL = ElementTree.parse(URDF).getroot()
TUTORIAL = read_yaml(room("configs") / "tutorial.yaml")["task"]


def numbers(path, attribute):
    """All numbers of an attribute of the one element at a path of the URDF."""
    (element,) = MODEL.findall(path)
    return [float(number) for number in element.get(attribute).split()]


def test_the_urdf_has_the_radius_of_the_base():
    assert numbers("link[@name='base']/collision/geometry/cylinder", "radius") == [robot.BASE_RADIUS]


@pytest.mark.parametrize(("wheel", "side"), [("wheel_left", 1), ("wheel_right", -1)])
def test_the_urdf_has_the_wheels_on_the_axle_with_their_size_and_torque(wheel, side):
    assert numbers(f"link[@name='{wheel}']/collision/geometry/sphere", "radius") == [robot.WHEEL_RADIUS]
    assert numbers(f"joint[@name='{wheel}']/origin", "xyz") == [
        0,
        side * robot.WHEEL_SEPARATION / 2,
        robot.WHEEL_RADIUS,
    ]
    assert numbers(f"joint[@name='{wheel}']/axis", "xyz") == [0, 1, 0]
    assert numbers(f"joint[@name='{wheel}']/limit", "effort") == [robot.WHEEL_TORQUE]


@pytest.mark.parametrize(("caster", "x"), [("caster_front", 0.115), ("caster_back", -0.135)])
def test_the_casters_stand_on_the_floor_inside_the_base(caster, x):
    (radius,) = numbers(f"link[@name='{caster}']/collision/geometry/sphere", "radius")
    assert numbers(f"joint[@name='{caster}']/origin", "xyz") == [x, 0, radius]
    assert abs(x) + radius < robot.BASE_RADIUS


def test_a_whole_turtlebot2_weighs_6_3_kg():
    assert sum(float(mass.get("value")) for mass in MODEL.iter("mass")) == pytest.approx(6.3, abs=0.1)


def test_the_laser_sweeps_720_beams_from_right_to_left():
    degrees = np.degrees(robot.Laser().angles)
    assert degrees.shape == (720,)
    assert degrees[[0, 719]] == pytest.approx([-90, 90])
    assert np.diff(degrees) == pytest.approx(180 / 719)
    assert abs(degrees[360]) <= 180 / 719 / 2 + 1e-9


def test_the_tutorial_keeps_every_144th_beam():
    laser = robot.Laser(beams=TUTORIAL["beams"], kept=tuple(TUTORIAL["kept"]))
    assert np.degrees(laser.angles) == pytest.approx([-90 + i * 180 / 719 for i in (0, 144, 288, 432, 576)])


def test_a_single_beam_looks_straight_ahead():
    assert robot.Laser(beams=1).angles == [0.0]


@pytest.mark.parametrize(
    ("command", "left_and_right"),
    [
        ((0.35, 0.0), (10.0, 10.0)),
        ((-0.35, 0.0), (-10.0, -10.0)),
        ((0.0, 1.0), (-0.115 / 0.035, 0.115 / 0.035)),  # to the left: the right wheel forward
        ((0.115, -1.0), (0.23 / 0.035, 0.0)),  # around the right wheel
    ],
)
def test_wheel_rates_are_those_of_a_differential_drive(command, left_and_right):
    assert robot.wheel_rates(np.array([command, command])) == pytest.approx(np.array([left_and_right] * 2))


def test_commands_are_cut_to_the_limits_and_otherwise_left_alone():
    commands = np.array([[(1.0, -4.0), (-0.7, 3.2)], [(0.65, -math.pi), (-0.3, 0.2)]])
    expected = np.array([[(0.65, -math.pi), (-0.65, math.pi)], [(0.65, -math.pi), (-0.3, 0.2)]])
    assert (robot.within_limits(commands) == expected).all()
