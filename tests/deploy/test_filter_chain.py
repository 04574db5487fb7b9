"""A driver slows its policy down before what the scanner sees, however few beams the policy has."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from tb2rl.commands.export import export_folder
from tb2rl.deploy import Driver, Scan, SpeedLimits, TrainedPolicy
from tb2rl.deploy.portable.policy import ExportedPolicy
from tb2rl.envs.safety import REASONS

ANGLES = np.linspace(-math.pi / 2, math.pi / 2, 181)


def scan_of_a_wall(distance):
    """A scan of a wall across the way, `distance` [m] ahead of the axle."""
    ranges = np.minimum(distance / np.maximum(np.cos(ANGLES), 1e-3), 10.0)
    return Scan(ranges, ANGLES[0], ANGLES[1] - ANGLES[0], 0.05, 30.0)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The folder of an exported policy with nine beams over 120 degrees."""
    folder = tmp_path_factory.mktemp("exported")
    export_folder("zoo:maze-loop-qlearn", folder)
    return folder


@pytest.fixture(scope="module", params=["trained", "exported"])
def policy(request, exported):
    """A policy that always drives ahead at 0.5 m/s."""
    policy = TrainedPolicy("zoo:maze-loop-qlearn") if request.param == "trained" else ExportedPolicy(exported)
    policy.act = lambda sensor_data: (0.5, 0.0)
    return policy


@pytest.fixture
def ask(policy):
    """A function from the distance of a wall to the command of a driver."""

    def ask(distance, age=0.0, **arguments):
        driver = Driver(policy, **arguments)
        for now in (10.0, 10.2):
            driver.see_scan(scan_of_a_wall(distance), now)
            driver.start()
            driver.command(now)
        return driver.command(10.4 + age), driver.filters

    return ask


def test_it_slows_down_before_a_wall_and_says_why(ask):
    free, filters = ask(3.0)
    assert (free.v, free.intervention, filters.interventions) == (0.5, "", 0)
    slow, filters = ask(0.28)
    assert 0.0 < slow.v < 0.5
    assert slow.intervention == REASONS[1]
    assert 1 <= filters.interventions <= filters.decisions == 3
    assert ask(0.19)[0].v == 0.0


def test_an_old_scan_costs_speed_and_off_means_off(ask):
    assert ask(0.5, age=0.4)[0].v < ask(0.5)[0].v
    assert ask(0.19, safe="off")[0].v == 0.5
    assert ask(0.19, safe="off", limits=SpeedLimits(0.2))[0].v == 0.2


def test_the_guaranteed_setting_needs_a_laser_that_sees_180_degrees(policy):
    with pytest.raises(ValueError, match="needs a laser that sees 180 degrees, not 120"):
        Driver(policy, safe="guaranteed")


def test_a_policy_that_was_trained_with_the_filter_keeps_its_own(policy):
    driver = Driver(TrainedPolicy("zoo:drive-loop-ppo"))
    assert driver.filters._safety
    own = TrainedPolicy("zoo:drive-loop-ppo")
    own.filters = [driver.filters._safety]
    assert Driver(own).filters._safety is None


def test_the_program_of_an_exported_policy_says_when_the_filter_slows_it_down(exported):
    scan = scan_of_a_wall(0.19)
    message = {"ranges": scan.ranges.tolist(), "angle_min": scan.angle_min, "angle_increment": scan.angle_increment}
    lines = [{"time": 1.0, "scan": {**message, "range_min": 0.05, "range_max": 30.0}, "start": True}, {"time": 1.1}]
    text = "\n".join(map(json.dumps, lines))
    command = "import drive; drive.ExportedPolicy.act = lambda *_: (0.5, 0.0); drive.main({})"
    answers = []
    for arguments in ([], ["--safe", "off"]):
        done = subprocess.run(
            [sys.executable, "-c", command.format(arguments)], cwd=exported, input=text, capture_output=True, text=True
        )
        answers.append(json.loads(done.stdout.splitlines()[0]))
    assert answers[0] == {"v": 0.0, "w": 0.0, "why": "driving", "intervention": REASONS[1]}
    assert answers[1] == {"v": 0.5, "w": 0.0, "why": "driving"}
