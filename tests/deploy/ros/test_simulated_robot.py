"""The simulated robot of `simulate`: commands, their timeout, and sensor messages."""

import numpy as np
import pytest

import tb2rl
from tb2rl.deploy.ros.events import BumperEvent
from tb2rl.deploy.ros.messages import Twist
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.envs.scene import make_scene
from tb2rl.simulation import find_simulator
from tb2rl.tasks.wander import Wander

FORWARD = Twist(0.5, 0.0)
both_simulators = pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])


def make_robot(simulation="kinematic", seed=0, scan_rate=10.0, long_ticks=False, **settings):
    scene = make_scene(Wander(**{"start": "fixed", **settings}), "raw")
    return SimulatedRobot(scene, find_simulator(simulation), seed, scan_rate, long_ticks)


def advance(robot, seconds):
    return [event for _ in range(round(seconds / robot.tick_duration)) for event in robot.step()]


@both_simulators
def test_it_executes_a_command_until_the_timeout_of_the_base(simulation):
    robot = make_robot(simulation)
    start = robot.odometry().pose[0]
    for seconds in (0.55, 0.6):
        robot.command(FORWARD)
        advance(robot, seconds)
        assert robot.odometry().twist == pytest.approx((0.5, 0.0), abs=0.01)
    advance(robot, 0.5)
    assert robot.odometry().twist == pytest.approx((0.0, 0.0), abs=1e-3)
    distance = robot.odometry().pose[0] - start
    assert 0.5 < distance < 0.5 * 1.2
    advance(robot, 1.0)
    assert robot.odometry().pose[0] - start == pytest.approx(distance, abs=1e-3)


@both_simulators
def test_commands_take_effect_late_and_sensors_show_the_past_with_its_time(simulation):
    late, prompt = (
        make_robot(simulation, variation={"latency": latency, "observation_latency": latency}) for latency in (1, 0)
    )
    for robot in (late, prompt):
        robot.command(FORWARD)
    moved = []
    for _ in range(40):
        for robot in (late, prompt):
            robot.step()
            robot.command(FORWARD)
        moved.append((late.odometry().pose[0], prompt.odometry().pose[0]))
    assert (late.clock().stamp, late.odometry().stamp, late.scan().stamp) == (10**9, 8 * 10**8, 8 * 10**8)
    assert late.transforms().transforms[0].stamp == 8 * 10**8
    assert [each for each, _ in moved[16:]] == pytest.approx([each for _, each in moved[:-16]], abs=1e-6)


def test_a_tick_lasts_at_most_25_ms_or_in_lockstep_from_scan_to_scan():
    robot = make_robot(scan_rate=5.0)
    assert (robot.tick_duration, robot.ticks_per_scan) == (0.025, 8)
    advance(robot, 1.0)
    assert {each.stamp for each in (robot.clock(), robot.scan(), robot.odometry())} == {10**9}
    assert make_robot(scan_rate=30.0).tick_duration * 2 == pytest.approx(1 / 30)
    assert make_robot(scan_rate=5.0, long_ticks=True).tick_duration == 0.2


@both_simulators
def test_long_ticks_are_the_steps_of_an_environment_to_the_bit(simulation):
    robot = make_robot(simulation, seed=3, scan_rate=5.0, long_ticks=True, start="random")
    env = tb2rl.make_env("maze", "raw", simulation=simulation, beams=720)
    env.reset(seed=3)
    for action in (0, 0, 1, 2, 1, 0):
        robot.command(Twist(*env.scene.actions.commands(np.array([action]))[0].tolist()))
        robot.step()
        env.step(action)
        np.testing.assert_array_equal(robot.scan().ranges, env.robot_state.ranges[0])


@both_simulators
def test_a_wall_presses_the_bumper_once(simulation):
    robot = make_robot(simulation, world="wall")
    events = []
    for _ in range(120):
        robot.command(FORWARD)
        events += advance(robot, 0.1)
    assert events[0] == BumperEvent(1, True)
    assert robot.record.contact_count >= 1
    assert robot.record.min_range < 0.25
    nearest = robot.scan().ranges.min()
    robot.command(Twist(-0.3, 0.0))
    assert advance(robot, 0.5)[-1] == BumperEvent(1, False)
    assert robot.scan().ranges.min() > nearest + 0.05
    assert f"touched something {robot.record.contact_count} times" in str(robot.record)


def test_a_reset_releases_a_pressed_bumper():
    robot, events = make_robot(world="wall"), []
    while not events:
        robot.command(FORWARD)
        events = advance(robot, 0.1)
    robot.reset()
    assert advance(robot, 0.1) == [BumperEvent(events[-1].part, False)]
    assert advance(robot, 1.0) == []


def test_a_contact_behind_the_robot_presses_no_bumper():
    robot, events = make_robot(), []
    for _ in range(40):
        robot.command(Twist(-0.5, 0.0))
        events += advance(robot, 0.1)
    assert robot.record.contact_count
    assert not events


@pytest.mark.bullet
def test_images_have_depths_and_in_pybullet_colours():
    colours, depth = make_robot("bullet").images()
    assert (colours.pixels.shape, colours.pixels.dtype) == ((240, 320, 3), np.uint8)
    assert (depth.pixels.shape, depth.pixels.dtype) == ((240, 320), np.float32)
    colours, kinematic = make_robot().images()
    assert colours is None
    both = np.isfinite(depth.pixels) & np.isfinite(kinematic.pixels)
    assert np.median(np.abs(depth.pixels[both] - kinematic.pixels[both])) < 0.02


@pytest.mark.bullet
def test_memory_does_not_grow_with_the_drive(monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.simulated_robot._TICKS_BETWEEN_READS", 4)
    robot = make_robot("bullet")
    advance(robot, 0.5)
    assert len(robot._simulator._command_log) <= 4
