"""Whatever scanner a robot has, the policy sees what the simulated laser would have shown, or hears what is missing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tb2rl.deploy import Mounting, Scan, ScanReader
from tb2rl.envs.worlds import find_worlds

CLOSE = 0.02  # [m]


@pytest.fixture(scope="module")
def worlds():
    """Built-in worlds and generated ones."""
    named = ("loop", "circuit", "round", "maze", "wall", {"generator": "mixed", "worlds": 10})
    return find_worlds(named)


def spoiled(scan, rng):
    """The scan with up to a twentieth of its readings lost, in the way of one driver or another."""
    lost = rng.random(len(scan.ranges)) < rng.choice([0.0, 0.02, 0.05])
    how = rng.integers(3)
    if how == 2:  # zeros mean nothing, and nothing means zero
        scan.ranges[np.isinf(scan.ranges)] = 0.0
    scan.ranges[lost] = (math.inf, math.nan, 0.0)[how]
    return scan


def beams_of(rng, field):
    """The directions of a policy's beams within a field of view [rad]."""
    half = min(rng.choice([math.pi, 2.0944]), 0.95 * field) / 2
    return np.linspace(-half, half, rng.choice([7, 9, 36, 60, 180]))


@pytest.mark.parametrize("sensors", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_random_sensors_show_what_the_simulated_laser_shows(told, worlds, make_sensor, cast_from, sensors):
    rng = np.random.default_rng(0)
    right = np.zeros(2, dtype=int)
    for _ in range(sensors):
        field, readings = rng.uniform(math.pi, math.tau), int(rng.integers(180, 1441))
        needs = told(beams=beams_of(rng, field), max_range=float(rng.choice([6.0, 30.0]))).needs
        turned, upside_down = rng.uniform(-math.pi, math.pi), bool(rng.integers(2))
        slack = 0.99 * (field - needs.field_of_view) / 2
        yaw = rng.uniform(-slack, slack) + (turned if upside_down else -turned)
        mounting = Mounting(*rng.uniform(-0.15, 0.15, 2), yaw, upside_down)
        sensor = make_sensor(field, readings, mounting, bool(rng.integers(2)), turned)
        world = worlds[rng.integers(len(worlds))]
        robot = world.poses_from(rng.random((1, 4)), 0.3)[0]
        scan = spoiled(sensor.scan(world, robot), rng)
        seen = ScanReader(needs, mounting).read(scan)
        if not scan.ranges.any():  # there is no telling open space from a scanner that is broken
            assert seen.lacks
            continue
        truth = cast_from(world, robot, needs.beams, needs.max_range)
        alike = (seen.ranges == truth) | (np.abs(seen.ranges - np.where(np.isinf(truth), 99.0, truth)) <= CLOSE)
        assert seen.lacks == ""
        right += np.count_nonzero(alike[seen.sure]), np.count_nonzero(seen.sure)
        assert seen.sure.mean() > 0.5
    assert right[0] / right[1] > 0.95


def test_beside_an_edge_nothing_is_farther_than_the_nearest_neighbouring_reading(told, worlds, make_sensor, cast_from):
    rng = np.random.default_rng(1)
    bins = 0
    for _ in range(60):
        world, readings = worlds[rng.integers(len(worlds))], int(rng.integers(180, 720))
        robot, sensor = world.poses_from(rng.random((1, 4)), 0.3)[0], make_sensor(math.pi, readings)
        scan = sensor.scan(world, robot)
        step, needs = sensor.angle_increment, told(beams=np.linspace(-1.5, 1.5, 180)).needs
        seen = ScanReader(needs).read(scan).ranges
        place = (needs.beams - scan.angle_min) / step
        low = place.astype(int)
        for beam in np.flatnonzero(np.abs(place - np.rint(place)) > 0.02):
            first, second = np.minimum(scan.ranges[low[beam] : low[beam] + 2], 50.0)
            fine = cast_from(world, robot, scan.angle_min + step * (low[beam] + np.linspace(0, 1, 11)), 30.0)
            jump = np.abs(np.diff(np.minimum(fine, 50.0))).max()
            if abs(first - second) > 0.3 and jump > 0.8 * abs(first - second):
                bins += 1
                assert seen[beam] <= min(first, second) + 0.01
    assert bins > 100


def test_the_training_laser_itself_is_shown_as_it_is_to_the_bit(told, worlds, make_sensor, cast_from):
    world, needs = worlds[0], told().needs
    ranges = cast_from(world, world.start, needs.beams, 30.0)
    scan = make_sensor(math.pi, 37).scan(world, np.array(world.start))
    scan = type(scan)(ranges, scan.angle_min, scan.angle_increment, 0.1, 30.0)
    assert ScanReader(needs).read(scan).ranges.tolist() == ranges.tolist()


def test_few_beams_far_apart_are_enough_if_they_are_those_of_the_training(told, scan_of):
    needs = told(beams=np.linspace(-math.pi / 2, math.pi / 2, 9)).needs
    seen = ScanReader(needs).read(scan_of(np.arange(1.0, 10.0)))
    assert seen.ranges.tolist() == list(range(1, 10))
    assert "22" in ScanReader(told().needs).read(scan_of(np.arange(1.0, 10.0))).lacks


@pytest.mark.parametrize(
    ("field", "yaw", "sentence"),
    [
        (
            60,
            0,
            "the scan covers 60 degrees (-30 to 30), the policy was trained with 180 degrees (-90 to 90); so narrow",
        ),
        (140, 0, "the scan covers 140 degrees (-70 to 70), the policy was trained with 180 degrees"),
        (
            180,
            90,
            "the scan covers 180 degrees (0 to 180), the policy was trained with 180 degrees (-90 to 90); check how",
        ),
        (180, 1, ""),
        (360, 123, ""),
        (359, 180, ""),
    ],
)
def test_a_scan_that_does_not_cover_what_the_policy_needs_is_refused_in_words(told, scan_of, field, yaw, sentence):
    seen = ScanReader(told().needs, Mounting(yaw=math.radians(yaw))).read(scan_of(np.ones(361), math.radians(field)))
    assert seen.lacks.startswith(sentence)
    assert bool(seen.lacks) == bool(sentence)


def test_a_wide_gap_of_readings_that_are_invalid_is_refused_and_a_narrow_one_is_bridged(told, scan_of):
    ranges = np.full(361, 2.0)
    ranges[100:116] = math.nan
    assert ScanReader(told().needs).read(scan_of(ranges)).ranges == pytest.approx(2.0, abs=CLOSE)
    ranges[100:140] = math.nan
    lacks = ScanReader(told().needs).read(scan_of(ranges)).lacks
    assert lacks == "the scan has no valid reading for 4 of the policy's 37 beams, from -40 to -25 degrees"
    assert "is the scanner turning?" in ScanReader(told().needs).read(scan_of(np.zeros(361))).lacks


@pytest.mark.parametrize(
    ("value", "where", "shown"),
    [
        (math.inf, slice(100, 140), math.inf),
        (30.0, slice(100, 140), math.inf),  # as older drivers say that there is nothing
        (-math.inf, slice(100, 140), 0.3),  # too near
        (0.25, slice(100, 140), 0.25),  # below range_min: it is there all the same
        (0.0, slice(100, 140), math.inf),
        (0.0, slice(120, 123), 2.0),
        (math.nan, slice(120, 123), 2.0),
    ],
)
def test_every_convention_of_a_reading_without_a_number(told, scan_of, value, where, shown):
    ranges = np.full(361, 2.0)
    ranges[where] = value
    ahead = told(beams=np.radians([-30.0, 0.0])).needs
    assert ScanReader(ahead).read(scan_of(ranges, range_min=0.3)).ranges[0] == pytest.approx(shown, abs=1e-3)


def test_zeros_between_readings_that_are_hardly_measurable_are_too_near(told, scan_of):
    bearings = np.linspace(-math.pi / 2, math.pi / 2, 361)
    wall = 0.1 / np.cos(bearings[1:-1])  # 0.1 m ahead
    ranges = np.array([math.inf, *np.where(wall < 0.15, 0.0, wall), math.inf])
    ahead = told(beams=np.array([0.0, 0.1])).needs
    assert ScanReader(ahead).read(scan_of(ranges, range_min=0.15)).ranges == pytest.approx(0.15, abs=1e-4)


def test_ranges_are_cut_to_what_the_policy_was_shown(told, scan_of):
    needs = told(min_range=0.3, max_range=5.0).needs
    assert ScanReader(needs).read(scan_of(np.full(361, 0.2))).ranges.tolist() == [0.3] * 37
    assert ScanReader(needs).read(scan_of(np.full(361, 6.0))).ranges.tolist() == [math.inf] * 37


@pytest.mark.parametrize(
    ("readings", "first", "step"), [(0, 0.0, 0.1), (1, 0.0, 0.1), (9, 0.0, 0.0), (9, math.nan, 0.1), (9, 0.0, math.inf)]
)
def test_a_scan_that_is_none_is_refused(told, readings, first, step):
    lacks = ScanReader(told().needs).read(Scan(np.ones(readings), first, step, 0.1, 5.0)).lacks
    assert lacks.startswith(f"a scan of {readings} readings")
