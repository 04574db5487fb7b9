"""A replay of a drive in the simulator that recorded it is exact, and shows how far another robot is from it."""

from dataclasses import replace

import numpy as np
import pytest

from tb2rl.calibration.replay import replay
from tb2rl.core.errors import InputError
from tb2rl.deploy.bags.reading import read_drive
from tb2rl.runs.config import resolve
from tb2rl.simulation import find_simulator
from tb2rl.viz.film import FilmOptions, record
from tb2rl.worlds.registry import find_world

pytest.importorskip("rosbags")
ODD = {"wheel_radius": 1.03, "gyro": 0.97, "latency": 1}


def scene(variation):
    return resolve("random", "drive", settings={"task.variation": variation}).scene


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive of 20 s by a robot that is late and drives differently from what it is told."""
    path, options = tmp_path_factory.mktemp("bags") / "drive.bag", FilmOptions(steps=100, simulation="kinematic")
    record("zoo:drive-loop-ppo", path, settings={"variation": ODD}, options=options)
    return read_drive(path, {}, scans=True)


def test_the_same_robot_is_where_it_was_and_sees_what_it_saw(drive):
    same = replay(drive, scene(ODD), find_simulator("kinematic"), find_world("loop"))
    assert len(same.times) == 3
    assert same.distances.max() < 1e-3
    assert same.turns.max() < 1e-3
    assert same.range_errors.max() < 1e-3
    assert str(same) == "0.000 m and 0.00 degrees apart after 5 s, ranges 0.000 m (medians of 3 windows)"


def test_another_robot_parts_from_it(drive):
    nominal = replay(drive, scene("none"), find_simulator("kinematic"), find_world("loop"))
    assert 0.03 < np.median(nominal.distances) < 0.5
    assert np.median(nominal.range_errors) > 0.01


def test_odometry_is_compared_with_odometry_and_without_a_world_no_ranges(drive):
    by_odometry = replace(drive, truth=drive.truth[:0])
    same = replay(by_odometry, scene(ODD), find_simulator("kinematic"))
    assert same.distances.max() < 0.01
    assert same.range_errors is None
    assert "ranges" not in str(same)
    placed = replay(by_odometry, scene(ODD), find_simulator("kinematic"), find_world("loop"))
    assert placed.paths[0, 0] == pytest.approx(find_world("loop").start[:2], abs=0.6), "the drive begins at the start"


def test_a_drive_without_commands_or_too_short_is_named(drive):
    with pytest.raises(InputError, match="has no commands to drive again"):
        replay(replace(drive, commands=drive.commands[:0]), scene("none"), find_simulator("kinematic"))
    short = replace(drive, truth=drive.truth[:20], odometry=drive.odometry[:20])
    with pytest.raises(InputError, match=r"lasts 3\.8 s, shorter than a window of 6 s"):
        replay(short, scene("none"), find_simulator("kinematic"))
