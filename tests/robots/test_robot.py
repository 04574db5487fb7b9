"""A robot's numbers: the URDF file that the physics reads must state the same ones."""

import math
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.core.files import read_yaml, top_folder
from tb2rl.core.plugins import robot_names
from tb2rl.robots import Laser
from tb2rl.robots.jackal import ROBOT as JACKAL
from tb2rl.robots.robot import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.robots.turtlebot3 import ROBOT as BURGER

TUTORIAL = read_yaml(top_folder("configs") / "tutorial.yaml")["task"]


def numbers(path, attribute, robot=ROBOT):
    """All numbers of an attribute of the one element at a path of a robot's URDF."""
    (element,) = ElementTree.parse(robot.urdf).getroot().findall(path)
    return [float(number) for number in element.get(attribute).split()]


@pytest.mark.parametrize("name", robot_names())
def test_the_urdf_has_the_robots_numbers(name):
    robot = find_robot(name)
    assert numbers("link[@name='base']/collision/geometry/cylinder", "radius", robot) == [robot.radius]
    for joint, side in zip(robot.wheel_joints, (1, -1), strict=True):
        place = [0, side * robot.wheel_separation / 2, robot.wheel_radius]
        assert numbers(f"joint[@name='{joint}']/origin", "xyz", robot) == place
        assert numbers(f"joint[@name='{joint}']/axis", "xyz", robot) == [0, 1, 0]
        assert numbers(f"joint[@name='{joint}']/limit", "effort", robot) == [robot.wheel_torque]
        assert numbers(f"link[@name='{joint}']/collision/geometry/sphere", "radius", robot) == [robot.wheel_radius]


@pytest.mark.parametrize(("name", "kilograms"), [("turtlebot2", 6.3), ("turtlebot3", 1.0), ("jackal", 17.0)])
def test_a_whole_robot_has_its_mass(name, kilograms):
    masses = ElementTree.parse(find_robot(name).urdf).getroot().iter("mass")
    assert sum(float(mass.get("value")) for mass in masses) == pytest.approx(kilograms, rel=0.015)


def test_the_turtlebot3_has_a_beam_for_each_degree_and_a_camera_of_62_degrees():
    assert np.degrees(BURGER.laser.angles) == pytest.approx(np.arange(-180, 180))
    width = 2 * math.atan(math.tan(BURGER.camera.field_of_view / 2) * 4 / 3)
    assert math.degrees(width) == pytest.approx(62.2)


def test_the_disc_of_the_jackal_is_as_long_as_the_robot_and_covers_its_wheels():
    assert pytest.approx(0.508 / 2, abs=0.01) == JACKAL.radius
    assert JACKAL.wheel_separation / 2 + JACKAL.wheel_radius < JACKAL.radius
    assert np.degrees(JACKAL.laser.angles[[0, -1]]) == pytest.approx([-135, 135])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"radius": "0.2"}, r"robot turtlebot2\.radius: .* valid number, got '0.2'"),
        ({"max_speed": math.nan}, r"robot turtlebot2\.max_speed: .* finite number, got nan"),
        ({"laser": Laser(field_of_view=270)}, r"laser\.field_of_view: .* equal to 6\.28.*, got 270"),
        ({"laser": Laser(min_range=5.0, max_range=2.0)}, r"turtlebot2\.laser: .* got 5.0, 2.0"),
        ({"camera": replace(ROBOT.camera, range=(8.0, 0.05))}, r"turtlebot2\.camera: .* got 8.0, 0.05"),
    ],
)
def test_invalid_numbers_are_refused_with_the_robots_name(changed, words, monkeypatch):
    monkeypatch.setattr("tb2rl.robots.turtlebot2.ROBOT", replace(ROBOT, **changed))
    with pytest.raises(InputError, match=words):
        find_robot("turtlebot2")


def test_the_tutorial_reads_every_144th_beam():
    laser = Laser(beams=TUTORIAL["beams"], indices=tuple(TUTORIAL["beam_indices"]))
    assert np.degrees(laser.angles) == pytest.approx([-90 + i * 180 / 719 for i in (0, 144, 288, 432, 576)])


@pytest.mark.parametrize("beams", [1, 2, 7, 36])
def test_beams_of_a_full_circle_are_even_and_symmetric_and_one_points_ahead(beams):
    angles = Laser(beams=beams, field_of_view=math.tau).angles
    assert len(angles) == beams
    assert 0.0 in angles
    assert np.diff(angles, append=angles[0] + math.tau) == pytest.approx(math.tau / beams)
    mirrored = np.sort(np.remainder(-angles, math.tau))
    assert mirrored == pytest.approx(np.sort(np.remainder(angles, math.tau))), "as far to the left as to the right"
