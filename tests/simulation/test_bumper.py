"""Walls stop the robot in PyBullet, and its bumper says so."""

import math

import numpy as np
import pytest
import shapely

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation import InitialState
from tb2rl.simulation.bullet.simulator import BulletSimulator
from tb2rl.simulation.spec import WHEEL
from tb2rl.worlds.registry import world_names

TARGETS = {
    "a wall": {"boxes": [{"centre": [0, 0], "size": [0.2, 6]}]},
    "a wall turned by 30 degrees": {"boxes": [{"centre": [0, 0], "size": [0.2, 6], "yaw": math.radians(30)}]},
    "a corner": {"boxes": [{"centre": [0, 0], "size": [1, 1], "yaw": math.radians(45)}]},
    "a post": {"posts": [{"centre": [0, 0], "radius": 0.3}]},
    "a thin post": {"posts": [{"centre": [0, 0], "radius": 0.03}]},
}


def tilt(simulation):
    qx, qy, _, _ = simulation.state()["orientation"]
    return math.acos(1 - 2 * (qx * qx + qy * qy))


def heading_for_a_wall(world, rng):
    """A random free pose that faces the nearest obstacle."""
    x, y, _ = world.random_poses(rng, 1, 0.25)[0]
    _, nearest = shapely.shortest_line(shapely.Point(x, y), world.obstacles).coords
    return x, y, math.atan2(nearest[1] - y, nearest[0] - x)


@pytest.mark.parametrize("name", world_names())
def test_300_commands_into_walls_neither_tip_it_nor_get_it_through_nor_move_a_wall(
    name, robot, make_setup, make_bullet
):
    spec, rng = make_setup(name, robot=robot, beams=1), np.random.default_rng(0)
    (world,) = spec.worlds
    limits = np.array([robot.max_speed, robot.max_turn_rate])
    probe, angles = world.random_poses(rng, 1, 0.0)[0], np.linspace(-3, 3, 50)
    simulation = make_bullet(spec)
    walls, bumps = simulation.ray_ranges(probe, angles), 0
    for _ in range(10):
        start = InitialState.default(spec, 1)
        start.pose[:] = heading_for_a_wall(world, rng)
        poses = [simulation.reset(start, rng).pose[0]]
        height = simulation.state()["position"][2]
        for step in range(30):
            command = limits * (rng.uniform(-1, 1, 2) if step % 2 else (rng.choice([1, 1, 1, -1]), 0))
            robot_state = simulation.step(command[None], 0.195 / robot.max_speed)
            poses.append(robot_state.pose[0])
            bumps += robot_state.bumped[0]
            assert world.clearance(*poses[-1][:2]) - robot.radius >= -5e-3
            assert math.degrees(tilt(simulation)) < 3
            assert simulation.state()["position"][2] == pytest.approx(height, abs=5e-3)
        assert not world.obstacles.intersects(shapely.LineString([pose[:2] for pose in poses]))
    assert bumps >= 5
    assert (simulation.ray_ranges(probe, angles) == walls).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("degrees", [0, 20, 45, -30])
def test_the_bumper_fires_when_the_laser_reads_contact_and_not_before(target, degrees, robot, make_track):
    # A laser that sees nothing nearer than the wall which the base touches cannot tell; so its shortest range is less.
    angle, track = math.radians(degrees), make_track(TARGETS[target], robot, beams=720, min_range=0.05)
    for speed in (0.15 * robot.max_speed, 0.77 * robot.max_speed, robot.max_speed):
        track.place(-math.cos(angle), -math.sin(angle), angle)
        readings = track.drive([(speed, 0.0)] * int(1.5 / speed / 0.02), 0.02)
        bumped = np.array([robot_state.bumped[0] for robot_state in readings])
        assert bumped.any()
        assert abs(readings[bumped.argmax()].ranges.min() - robot.radius) < 0.01
        assert (track.gaps(readings)[bumped] < 0.01).all()


def test_a_wall_that_is_hit_at_full_speed_gives_way_by_less_than_5_mm(robot, make_track):
    speeding_up = robot.max_speed / robot.wheel_acceleration / 2  # [s] that it needs longer
    track, steps = make_track(TARGETS["a wall"], robot), int((1.4 / robot.max_speed + speeding_up) * 60)
    for x in np.linspace(-1.2, -1.212, 13):  # the last step before the wall ends anywhere within 1 cm of it
        track.place(x)
        gaps = track.gaps(track.drive([(robot.max_speed, 0.0)] * steps, 1 / 60))
        assert -5e-3 < gaps.min() < 5e-3


def test_the_bumper_feels_what_is_behind(robot, make_track):
    track = make_track(TARGETS["a wall"], robot)
    track.place(-0.5, 0.0, math.pi)
    readings = track.drive([(-0.5, 0.0)] * 120, 0.02)
    bumped = np.array([robot_state.bumped[0] for robot_state in readings])
    assert bumped.any()
    assert (track.gaps(readings)[bumped] < 0.01).all()


def test_the_bumper_remembers_a_touch_within_a_long_step(make_track):
    track = make_track(TARGETS["a thin post"])
    track.place(-0.3, 0.03 + ROBOT.radius - 0.01)
    (robot_state,) = track.drive([(0.5, 0.0)], 1.5)
    assert robot_state.bumped[0]
    assert track.gaps([robot_state]) > 0.1  # and has long passed


def test_a_touch_is_felt_when_larger_wheels_drive_faster_than_the_top_speed(make_track):
    track = make_track(TARGETS["a thin post"])
    start = InitialState.default(track.simulation.spec, 1)
    start.pose[:], start.table[:, WHEEL] = (-0.9, 0.03 + ROBOT.radius - 0.01, 0.0), 2.0
    track.simulation.reset(start, np.random.default_rng(0))
    (robot_state,) = track.drive([(ROBOT.max_speed, 0.0)], 1.5)
    assert robot_state.bumped[0]
    assert track.gaps([robot_state]) > 0.1


def test_contacts_are_asked_for_only_where_a_touch_is_possible(make_track, monkeypatch):
    asked = []
    feel = BulletSimulator._touches_a_wall
    monkeypatch.setattr(BulletSimulator, "_touches_a_wall", lambda self: asked.append(1) or feel(self))
    track = make_track(TARGETS["a wall"])
    for gap, most in ((0.3, 0), (0.1, 7), (0.05, 13), (0.005, 16)):  # in the 16 physics steps of 0.2 s
        track.place(-0.1 - ROBOT.radius - gap)
        asked.clear()
        track.drive([(0.05, 1.0)])
        assert len(asked) <= most
    assert asked


def test_a_touch_is_felt_as_if_every_physics_step_were_asked_for(make_track, monkeypatch):
    track, rng = make_track(TARGETS["a corner"]), np.random.default_rng(0)
    commands = rng.uniform((0.2, -1.0), (ROBOT.max_speed, 1.0), (300, 2)) * rng.choice([1, 1, -1], (300, 1))

    def felt():
        track.place(-1.2)
        return track.record(track.drive(commands))

    spared = felt()
    monkeypatch.setattr("tb2rl.simulation.bullet._MARGIN", math.inf)
    assert (felt() == spared).all()
    assert 5 < spared[:, -1].sum() < 295
