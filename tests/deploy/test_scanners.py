"""The scanners of the page for robots work with policies as its table says, and mountings as it shows them."""

import math

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.deploy import Driver, Scan
from tb2rl.deploy.description import find_needs
from tb2rl.deploy.portable.scan_reader import ScanReader
from tb2rl.deploy.ros.robot import parse_mounting
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.envs.parts import robot_facts
from tb2rl.envs.scene import make_scene
from tb2rl.runs.config import resolve
from tb2rl.simulation import find_simulator
from tb2rl.tasks.wander import Wander
from tb2rl.zoo.entry import entries


def scanner(degrees, readings, range_min, range_max):
    """A scan of 2 m everywhere."""
    field = math.radians(degrees)
    return Scan(np.full(readings, 2.0), -field / 2, field / (readings - 1), range_min, range_max)


SCANNERS = {
    "RPLIDAR": scanner(359, 360, 0.15, 12.0),
    "Hokuyo URG-04LX": scanner(240, 683, 0.02, 5.6),
    "Hokuyo UTM-30LX": scanner(270, 1081, 0.1, 30.0),
    "depth camera": scanner(57, 640, 0.45, 10.0),
}


def problems(scan):
    """What prevents the policies of the zoo from reading a scan."""
    found = {}
    for entry in entries():
        try:
            needs = find_needs(entry.config.scene)
        except InputError:  # a policy with a camera
            continue
        found[entry.name] = ScanReader(needs).read(scan).problem
    assert len(found) > 20
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", SCANNERS)
def test_every_policy_of_the_zoo_works_with_a_wide_scanner_and_none_with_a_depth_camera(name):
    found = problems(SCANNERS[name])
    if name == "depth camera":
        assert all("use a scanner with a wider field of view" in problem for problem in found.values())
    else:
        assert {policy: problem for policy, problem in found.items() if problem} == {}


def test_a_policy_with_a_narrow_field_of_view_and_the_safety_filter_drive_by_a_depth_camera(scripted_policy):
    scene = resolve(settings={"task.field_of_view": 1.0, "task.beams": 36}, preset="anywhere-sac").scene
    policy = scripted_policy(**vars(find_needs(scene)))
    policy.speeds, policy.safety = (0.4, 0.0), robot_facts(scene.task, scene.spec)
    driver = Driver(policy)
    driver.see_scan(SCANNERS["depth camera"], 0.0)
    driver.see_odometry((0.0, 0.0, 0.0), (0.0, 0.0), 0.0)
    assert not [finding for finding in driver.preflight() if finding.is_error]
    driver.start()
    command = driver.command(0.0)
    assert (command.v, command.why) == (0.4, "driving")


@pytest.mark.parametrize(("mounting", "problem"), [("0.1,0,3.14159", "is mounted"), ("-0.05,0,0,upside-down", "")])
def test_the_scanner_of_the_simulated_robot_looks_ahead(mounting, problem):
    robot = SimulatedRobot(make_scene(Wander(start="fixed"), "raw"), find_simulator("kinematic"), 0, 10.0, False)
    needs = find_needs(resolve("ppo", "drive").scene)
    found = ScanReader(needs, parse_mounting(mounting)).read(robot.scan().to_scan()).problem
    assert problem in found
    assert bool(found) == bool(problem)
