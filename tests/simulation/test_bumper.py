"""Walls stop the robot in each physics, and its bumper detects every contact."""

import math

import numpy as np
import pytest
import shapely

from tb2rl.robots.robot import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.worlds.registry import world_names

TARGETS = {
    "a wall": {"boxes": [{"centre": [0, 0], "size": [0.2, 6]}]},
    "a wall turned by 30 degrees": {"boxes": [{"centre": [0, 0], "size": [0.2, 6], "yaw": math.radians(30)}]},
    "a corner": {"boxes": [{"centre": [0, 0], "size": [1, 1], "yaw": math.radians(45)}]},
    "a post": {"posts": [{"centre": [0, 0], "radius": 0.3}]},
    "a thin post": {"posts": [{"centre": [0, 0], "radius": 0.03}]},
}


def height_and_tilt(simulation):
    """Of the robot's base [m, rad] in PyBullet; `state()` builds the world anew, which takes long."""
    pybullet = pytest.importorskip("pybullet")
    (_, _, height), (qx, qy, _, _) = pybullet.getBasePositionAndOrientation(simulation._body.body, simulation._client)
    return height, math.acos(1 - 2 * (qx * qx + qy * qy))


def heading_for_a_wall(world, rng):
    """A random free pose that faces the nearest obstacle."""
    x, y, _ = world.sample_poses(rng.random((1, 4)), 0.25)[0]
    _, nearest = shapely.shortest_line(shapely.Point(x, y), world.obstacles).coords
    return x, y, math.atan2(nearest[1] - y, nearest[0] - x)


@pytest.mark.parametrize(
    ("name", "robot_name"),
    [*((world, "turtlebot2") for world in world_names()), ("loop", "turtlebot3"), ("maze", "jackal")],
)
def test_commands_into_walls_neither_tip_the_robot_nor_drive_it_through_nor_move_a_wall(
    name, robot_name, make_spec, make_bullet, start_at, begin, ray_ranges
):
    robot, rng = find_robot(robot_name), np.random.default_rng(0)
    spec = make_spec(name, robot=robot, beams=1)
    (world,) = spec.worlds
    limits = np.array([robot.max_speed, robot.max_turn_rate])
    probe, angles = world.sample_poses(rng.random((1, 4)), 0.0)[0], np.linspace(-3, 3, 50)
    simulation = make_bullet(spec)
    walls, bumps = ray_ranges(simulation, probe, angles), 0
    for _ in range(10):
        poses = [begin(simulation, start_at(spec, [heading_for_a_wall(world, rng)])).pose[0]]
        standing, _ = height_and_tilt(simulation)
        for step in range(30):
            command = limits * (rng.uniform(-1, 1, 2) if step % 2 else (rng.choice([1, 1, 1, -1]), 0))
            robot_state = simulation.step(command[None], 0.195 / robot.max_speed)
            poses.append(robot_state.pose[0])
            bumps += robot_state.bumped[0]
            assert world.clearance(*poses[-1][:2]) - robot.radius >= -5e-3
            height, tilt = height_and_tilt(simulation)
            assert math.degrees(tilt) < 3
            assert height == pytest.approx(standing, abs=5e-3)
        assert not world.obstacles.intersects(shapely.LineString([pose[:2] for pose in poses]))
    assert bumps >= 5
    assert (ray_ranges(simulation, probe, angles) == walls).all()


@pytest.mark.parametrize(("target", "degrees"), list(zip(TARGETS, [0, 45, -30, 20, 0], strict=True)))
def test_the_bumper_fires_when_the_laser_reads_contact_and_not_before(target, degrees, robot, make_track):
    # A laser that sees nothing nearer than the wall which the base touches cannot tell; so its shortest range is less.
    angle, track = math.radians(degrees), make_track(TARGETS[target], robot, beams=720, min_range=0.05)
    for speed in (0.3 * robot.max_speed, robot.max_speed):
        track.place(-math.cos(angle), -math.sin(angle), angle)
        states = track.drive([(speed, 0.0)] * int(1.5 / speed / 0.02), 0.02)
        bumped = np.array([state.bumped[0] for state in states])
        assert bumped.any()
        assert abs(states[bumped.argmax()].ranges.min() - robot.radius) < 0.01
        assert (track.gaps(states)[bumped] < 0.01).all()


@pytest.mark.parametrize(("x", "wheel", "speed"), [(-0.3, 1.0, 0.5), (-0.9, 2.0, ROBOT.max_speed)])
def test_a_long_step_reports_a_short_contact_even_with_wheels_that_exceed_the_top_speed(
    x, wheel, speed, make_track, start_at, begin
):
    track = make_track(TARGETS["a thin post"])
    pose = x, 0.03 + ROBOT.radius - 0.01, 0.0
    begin(track.simulation, start_at(track.simulation.spec, [pose], wheel_radius=wheel))
    (robot_state,) = track.drive([(speed, 0.0)], 1.5)
    assert robot_state.bumped[0]
    assert track.gaps([robot_state]) > 0.1  # and it has long passed


@pytest.mark.parametrize("physics", ["bullet"], indirect=True)
def test_a_contact_is_reported_as_if_every_physics_step_were_checked(make_track, monkeypatch):
    track, rng = make_track(TARGETS["a corner"]), np.random.default_rng(0)
    commands = rng.uniform((0.2, -1.0), (ROBOT.max_speed, 1.0), (300, 2)) * rng.choice([1, 1, -1], (300, 1))

    def drive():
        track.place(-1.2)
        return track.drive(commands)

    states = drive()
    monkeypatch.setattr("tb2rl.simulation.bullet.simulator._MARGIN", math.inf)
    np.testing.assert_array_equal(track.record(drive()), track.record(states))
    assert 5 < sum(state.bumped[0] for state in states) < 295
