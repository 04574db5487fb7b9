"""The simulated robot behind ROS: it obeys, stops when nobody commands it, and says what its sensors say."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tb2rl
from tb2rl.deploy.ros.messages import Bump, Velocity
from tb2rl.deploy.ros.simulator import Simulator
from tb2rl.envs.scene import make_scene
from tb2rl.simulation import SIMULATIONS
from tb2rl.tasks.wander import Wander

FORWARD = Velocity(0.5, 0.0)


def simulator(simulation="kinematic", seed=0, scan_rate=10.0, coarse=False, **settings):
    scene = make_scene(Wander(**{"start": "fixed", **settings}), "raw")
    return Simulator(scene, simulation, seed, scan_rate, coarse)


def advance(robot, seconds):
    return [bump for _ in range(round(seconds / robot.tick)) for bump in robot.advance()]


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_it_obeys_and_stops_when_it_hears_nothing_for_as_long_as_the_base_waits(simulation):
    robot = simulator(simulation)
    start = robot.odometry().pose
    robot.drive(FORWARD)
    advance(robot, 0.55)
    assert robot.odometry().twist == pytest.approx((0.5, 0.0), abs=0.01)
    robot.drive(FORWARD)
    advance(robot, 0.6)
    assert robot.odometry().twist[0] == pytest.approx(0.5, abs=0.01)
    advance(robot, 0.5)
    assert robot.odometry().twist == pytest.approx((0.0, 0.0), abs=1e-3)
    gone = robot.odometry().pose[0] - start[0]
    assert 0.5 < gone < 0.5 * 1.2
    advance(robot, 1.0)
    assert robot.odometry().pose[0] - start[0] == pytest.approx(gone, abs=1e-3)


def test_time_goes_on_by_ticks_and_the_laser_sweeps_as_often_as_was_asked():
    robot = simulator(scan_rate=5.0)
    assert (robot.tick, robot.ticks_per_scan) == (0.025, 8)
    advance(robot, 1.0)
    assert robot.clock().stamp == 1_000_000_000
    assert {robot.scan().stamp, robot.odometry().stamp, robot.transforms().stamp} == {1_000_000_000}
    assert simulator(scan_rate=30.0).tick * 2 == pytest.approx(1 / 30)
    assert simulator(scan_rate=5.0, coarse=True).tick == 0.2


def test_a_scan_is_the_robots_whole_laser_whatever_beams_the_task_reads():
    scan = simulator(beams=5).scan()
    assert scan.ranges.shape == (720,)
    assert (scan.angle_min, scan.period) == (-math.pi / 2, 0.1)
    assert scan.angle_min + 719 * scan.angle_increment == pytest.approx(math.pi / 2)
    assert (scan.range_min, scan.range_max) == (0.1, 30.0)
    env = tb2rl.make_env("maze", "raw", simulation="kinematic", start="fixed", beams=720)
    env.reset(seed=0)
    np.testing.assert_array_equal(scan.ranges, env.unwrapped.robot_state.ranges[0])


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_coarse_ticks_are_the_steps_of_an_environment_to_the_bit(simulation):
    robot = simulator(simulation, seed=3, scan_rate=5.0, coarse=True, start="random")
    env = tb2rl.make_env("maze", "raw", simulation=simulation, beams=720)
    env.reset(seed=3)
    for action in (0, 0, 1, 2, 1, 0):
        v, w = env.unwrapped.scene.actions.commands(np.array([action]))[0].tolist()
        robot.drive(Velocity(v, w))
        robot.advance()
        env.step(action)
        np.testing.assert_array_equal(robot.scan().ranges, env.unwrapped.robot_state.ranges[0])


def test_it_is_put_back_at_its_start_and_time_goes_on_unless_it_is_to_begin_again():
    robot = simulator()
    start = robot.odometry().pose
    robot.drive(FORWARD)
    advance(robot, 0.5)
    robot.put_back()
    assert (robot.odometry().pose, robot.odometry().twist) == (start, (0.0, 0.0))
    assert robot.clock().stamp == 500_000_000
    advance(robot, 0.5)
    assert robot.odometry().pose == pytest.approx(start), "the command was for before"
    robot.put_back(clock=True)
    assert robot.clock().stamp == 0


def test_random_starts_are_those_of_the_seed():
    def starts(seed):
        robot = simulator(seed=seed, start="random")
        found = [robot.odometry().pose]
        for _ in range(3):
            robot.put_back()
            found.append(robot.odometry().pose)
        return found

    assert starts(1) == starts(1)
    assert len({*starts(1), *starts(2)}) == 8


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_it_stands_against_a_wall_and_says_so_once(simulation):
    robot = simulator(simulation, world="wall")
    bumps = []
    for _ in range(300):
        robot.drive(FORWARD)
        bumps += advance(robot, 0.1)
    assert bumps[0] == Bump(1, True)
    assert robot.record.touches >= 1
    assert robot.record.nearest < 0.25
    standing = robot.odometry().stamp, robot.scan().ranges.min()
    robot.drive(Velocity(-0.3, 0.0))
    bumps = advance(robot, 0.5)
    assert bumps[-1] == Bump(1, False)
    assert robot.scan().ranges.min() > standing[1] + 0.05
    assert f"touched something {robot.record.touches} times" in str(robot.record)


def test_it_sees_colours_in_pybullet_and_depths_in_both():
    colours, depth = simulator("bullet").images()
    assert (colours.pixels.shape, colours.pixels.dtype) == ((240, 320, 3), np.uint8)
    assert (depth.pixels.shape, depth.pixels.dtype) == ((240, 320), np.float32)
    colours, flat = simulator().images()
    assert colours is None
    both = np.isfinite(depth.pixels) & np.isfinite(flat.pixels)
    assert np.median(np.abs(depth.pixels[both] - flat.pixels[both])) < 0.02


def test_a_command_that_is_no_number_stops_the_base():
    class Vector:
        x, z = math.nan, 1.0

    class Twist:
        linear = angular = Vector

    assert Velocity.from_ros(Twist) == Velocity(0.0, 0.0)


def test_it_does_not_remember_its_whole_way(monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.simulator._FORGETTING", 4)
    robot = simulator("bullet")
    robot.drive(FORWARD)
    advance(robot, 0.5)
    assert len(robot._simulation._driven) <= 4
    assert robot.odometry().twist[0] == pytest.approx(0.5, abs=0.01)
