"""The simulated robot of `simulate`: commands, their timeout, and sensor messages."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tb2rl
from tb2rl.deploy.ros.messages import BumperEvent, Twist
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.envs.scene import make_scene
from tb2rl.tasks.wander import Wander

FORWARD = Twist(0.5, 0.0)


def make_robot(simulation="kinematic", seed=0, scan_rate=10.0, coarse=False, **settings):
    scene = make_scene(Wander(**{"start": "fixed", **settings}), "raw")
    return SimulatedRobot(scene, simulation, seed, scan_rate, coarse)


def advance(robot, seconds):
    return [event for _ in range(round(seconds / robot.tick)) for event in robot.step()]


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_it_executes_a_command_until_the_timeout_of_the_base(simulation):
    robot = make_robot(simulation)
    start = robot.odometry().pose
    robot.command(FORWARD)
    advance(robot, 0.55)
    assert robot.odometry().twist == pytest.approx((0.5, 0.0), abs=0.01)
    robot.command(FORWARD)
    advance(robot, 0.6)
    assert robot.odometry().twist[0] == pytest.approx(0.5, abs=0.01)
    advance(robot, 0.5)
    assert robot.odometry().twist == pytest.approx((0.0, 0.0), abs=1e-3)
    gone = robot.odometry().pose[0] - start[0]
    assert 0.5 < gone < 0.5 * 1.2
    advance(robot, 1.0)
    assert robot.odometry().pose[0] - start[0] == pytest.approx(gone, abs=1e-3)


def test_ticks_and_scan_rate():
    robot = make_robot(scan_rate=5.0)
    assert (robot.tick, robot.ticks_per_scan) == (0.025, 8)
    advance(robot, 1.0)
    assert robot.clock().stamp == 1_000_000_000
    assert {robot.scan().stamp, robot.odometry().stamp, robot.transforms().stamp} == {1_000_000_000}
    assert make_robot(scan_rate=30.0).tick * 2 == pytest.approx(1 / 30)
    assert make_robot(scan_rate=5.0, coarse=True).tick == 0.2


def test_a_scan_has_all_beams_of_the_robots_laser():
    scan = make_robot(beams=5).scan()
    assert scan.ranges.shape == (720,)
    assert (scan.angle_min, scan.period) == (-math.pi / 2, 0.1)
    assert scan.angle_min + 719 * scan.angle_increment == pytest.approx(math.pi / 2)
    assert (scan.range_min, scan.range_max) == (0.1, 30.0)
    env = tb2rl.make_env("maze", "raw", simulation="kinematic", start="fixed", beams=720)
    env.reset(seed=0)
    np.testing.assert_array_equal(scan.ranges, env.unwrapped.robot_state.ranges[0])


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_coarse_ticks_are_the_steps_of_an_environment_to_the_bit(simulation):
    robot = make_robot(simulation, seed=3, scan_rate=5.0, coarse=True, start="random")
    env = tb2rl.make_env("maze", "raw", simulation=simulation, beams=720)
    env.reset(seed=3)
    for action in (0, 0, 1, 2, 1, 0):
        v, w = env.unwrapped.scene.actions.commands(np.array([action]))[0].tolist()
        robot.command(Twist(v, w))
        robot.step()
        env.step(action)
        np.testing.assert_array_equal(robot.scan().ranges, env.unwrapped.robot_state.ranges[0])


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_wall_presses_the_bumper_once(simulation):
    robot = make_robot(simulation, world="wall")
    events = []
    for _ in range(120):
        robot.command(FORWARD)
        events += advance(robot, 0.1)
    assert events[0] == BumperEvent(1, True)
    assert robot.record.contacts >= 1
    assert robot.record.nearest < 0.25
    standing = robot.odometry().stamp, robot.scan().ranges.min()
    robot.command(Twist(-0.3, 0.0))
    events = advance(robot, 0.5)
    assert events[-1] == BumperEvent(1, False)
    assert robot.scan().ranges.min() > standing[1] + 0.05
    assert f"touched something {robot.record.contacts} times" in str(robot.record)


def test_images_have_depths_and_in_pybullet_colours():
    colours, depth = make_robot("bullet").images()
    assert (colours.pixels.shape, colours.pixels.dtype) == ((240, 320, 3), np.uint8)
    assert (depth.pixels.shape, depth.pixels.dtype) == ((240, 320), np.float32)
    colours, flat = make_robot().images()
    assert colours is None
    both = np.isfinite(depth.pixels) & np.isfinite(flat.pixels)
    assert np.median(np.abs(depth.pixels[both] - flat.pixels[both])) < 0.02


def test_memory_does_not_grow_with_the_drive(monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.simulated_robot._TRIMMED", 4)
    robot = make_robot("bullet")
    robot.command(FORWARD)
    advance(robot, 0.5)
    assert len(robot._simulator._driven) <= 4
    assert robot.odometry().twist[0] == pytest.approx(0.5, abs=0.01)
