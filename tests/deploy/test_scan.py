"""Any scanner shows the policy the ranges of the simulated laser, or the reader says what is missing."""

import math

import numpy as np
import pytest

from tb2rl.deploy import Mounting, Scan, ScanReader
from tb2rl.envs.worlds import find_worlds
from tb2rl.worlds.geometry import cast_many

CLOSE = 0.02  # [m]


@pytest.fixture
def read(scripted_policy):
    """A function that reads a scan for a policy with these needs."""

    def read(scan, mounting=None, **needs):
        return ScanReader(scripted_policy(**needs).needs, mounting).read(scan)

    return read


def cast(world, pose, angles, max_range=30.0):
    """Exact ranges from a pose [m]; inf beyond the maximum."""
    ranges = np.empty((1, len(angles)))
    cast_many(np.array([pose]), np.zeros(1), (np.cos(angles), np.sin(angles)), world.spatial_index, ranges)
    return np.where(ranges[0] > max_range, np.inf, ranges[0])


def scan_from(world, robot, field, readings, mounting, clockwise, turned):
    """The scan of a scanner, float32 as in ROS; the middle of its field of view is turned from its angle 0 [rad]."""
    m, (x, y, yaw) = mounting, robot.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    pose = x + cos * m.x - sin * m.y, y + sin * m.x + cos * m.y, yaw + m.yaw
    sign = -1.0 if clockwise else 1.0
    first, step = turned - sign * field / 2, sign * field / (readings - 1)
    angles = first + step * np.arange(readings)
    ranges = cast(world, pose, -angles if m.upside_down else angles)
    return Scan(ranges.astype(np.float32), first, step, 0.1, 30.0)


def spoil(scan, rng):
    """Invalidate up to a twentieth of the readings, in the convention of one driver or another."""
    lost = rng.random(len(scan.ranges)) < rng.choice([0.0, 0.02, 0.05])
    convention = rng.integers(3)
    if convention == 2:  # zeros mean nothing, and nothing means zero
        scan.ranges[np.isinf(scan.ranges)] = 0.0
    scan.ranges[lost] = (math.inf, math.nan, 0.0)[convention]
    return scan


def test_random_scanners_show_the_ranges_of_the_simulated_laser(read):
    worlds = find_worlds(("loop", "circuit", "round", "maze", "wall", {"generator": "mixed", "worlds": 4}))
    rng, alike = np.random.default_rng(0), []
    for _ in range(60):
        field, readings = rng.uniform(math.pi, math.tau), int(rng.integers(180, 1441))
        half = min(rng.choice([math.pi, 2.0944]), 0.95 * field) / 2
        directions, max_range = np.linspace(-half, half, rng.choice([7, 9, 36, 60, 180])), rng.choice([6.0, 30.0])
        turned, upside_down = rng.uniform(-math.pi, math.pi), bool(rng.integers(2))
        slack = 0.99 * (field / 2 - half)
        yaw = rng.uniform(-slack, slack) + (turned if upside_down else -turned)
        mounting = Mounting(*rng.uniform(-0.15, 0.15, 2), yaw, upside_down)
        world = worlds[rng.integers(len(worlds))]
        robot = world.sample_poses(rng.random((1, 4)), 0.3)[0]
        scan = spoil(scan_from(world, robot, field, readings, mounting, rng.integers(2), turned), rng)
        seen = read(scan, mounting, beams=directions, max_range=float(max_range))
        assert bool(seen.problem) == (not scan.ranges.any()), "open space looks like a broken scanner"
        if not seen.problem:
            truth = cast(world, robot, directions, max_range)
            alike += np.isclose(np.minimum(seen.ranges, 99.0), np.minimum(truth, 99.0), rtol=0.0, atol=CLOSE).tolist()
    assert np.mean(alike) > 0.9


def test_a_beam_at_an_edge_is_not_longer_than_the_nearer_reading(read, scan_of):
    scan = scan_of(np.where(np.arange(361) < 180, 1.0, 5.0))
    between = scan.angle_min + scan.angle_increment * np.linspace(179.1, 179.9, 9)
    assert read(scan, beams=between).ranges == pytest.approx(1.0, abs=0.01)


def test_the_laser_of_the_training_is_read_to_the_bit(read, scan_of):
    ranges = np.random.default_rng(0).uniform(0.2, 20.0, 37)
    assert read(scan_of(ranges)).ranges.tolist() == ranges.tolist()


def test_few_readings_far_apart_are_enough_only_along_the_beams(read, scan_of):
    scan = scan_of(np.arange(1.0, 10.0))
    assert read(scan, beams=np.linspace(-math.pi / 2, math.pi / 2, 9)).ranges.tolist() == list(range(1, 10))
    assert "22" in read(scan).problem


@pytest.mark.parametrize(
    ("field", "yaw", "problem"),
    [
        (60, 0, "covers 60 degrees (-30 to 30), the policy was trained with 180 degrees (-90 to 90); use a scanner"),
        (140, 0, "covers 140 degrees (-70 to 70), the policy was trained with 180 degrees"),
        (180, 90, "covers 180 degrees (0 to 180), the policy was trained with 180 degrees (-90 to 90); check how"),
        (179, 180, "covers 179 degrees (90 to 270), the policy was trained with 180 degrees (-90 to 90); check how"),
        (180, 1, ""),
        (359, 180, ""),
    ],
)
def test_a_scan_that_does_not_cover_the_beams_is_refused(read, scan_of, field, yaw, problem):
    found = read(scan_of(np.ones(361), math.radians(field)), Mounting(yaw=math.radians(yaw))).problem
    assert problem in found
    assert bool(found) == bool(problem)


def test_a_wide_gap_of_invalid_readings_is_refused_and_a_narrow_one_is_bridged(read, scan_of):
    ranges = np.full(361, 2.0)
    ranges[100:116] = math.nan
    assert read(scan_of(ranges)).ranges == pytest.approx(2.0, abs=CLOSE)
    ranges[100:140] = math.nan
    problem = "the scan has no valid reading for 4 of the policy's 37 beams, from -40 to -25 degrees"
    assert read(scan_of(ranges)).problem == problem
    assert "is the scanner turning?" in read(scan_of(np.zeros(361))).problem


@pytest.mark.parametrize(
    ("value", "where", "shown"),
    [
        (math.inf, slice(100, 140), math.inf),
        (30.0, slice(100, 140), math.inf),  # nothing there, in older drivers
        (-math.inf, slice(100, 140), 0.3),  # too near
        (0.25, slice(100, 140), 0.25),  # below range_min, and an obstacle all the same
        (0.0, slice(100, 140), math.inf),
        (0.0, slice(120, 123), 2.0),
        (math.nan, slice(120, 123), 2.0),
    ],
)
def test_each_convention_of_invalid_readings_is_understood(read, scan_of, value, where, shown):
    ranges = np.full(361, 2.0)
    ranges[where] = value
    beams = np.radians([-30.0, 0.0])
    assert read(scan_of(ranges, range_min=0.3), beams=beams).ranges[0] == pytest.approx(shown, abs=1e-3)


def test_zeros_between_readings_near_range_min_are_too_near(read, scan_of):
    bearings = np.linspace(-math.pi / 2, math.pi / 2, 361)
    wall = 0.1 / np.cos(bearings[1:-1])  # 0.1 m ahead
    ranges = np.array([math.inf, *np.where(wall < 0.15, 0.0, wall), math.inf])
    seen = read(scan_of(ranges, range_min=0.15), beams=np.array([0.0, 0.1]))
    assert seen.ranges == pytest.approx(0.15, abs=1e-4)


@pytest.mark.parametrize(("measured", "shown"), [(0.2, 0.3), (6.0, math.inf)])
def test_ranges_are_limited_to_those_of_the_training(read, scan_of, measured, shown):
    assert read(scan_of(np.full(361, measured)), min_range=0.3, max_range=5.0).ranges.tolist() == [shown] * 37


@pytest.mark.parametrize(("readings", "first", "step"), [(0, 0.0, 0.1), (9, 0.0, 0.0), (9, math.nan, 0.1)])
def test_a_scan_without_directions_is_refused(read, readings, first, step):
    assert read(Scan(np.ones(readings), first, step, 0.1, 5.0)).problem.startswith(f"a scan of {readings} readings")
