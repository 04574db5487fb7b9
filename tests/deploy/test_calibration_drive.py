"""The calibration drive in a simulated room."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from tb2rl.deploy.calibration_drive import CalibrationDrive
from tb2rl.deploy.portable.driver import Driver
from tb2rl.deploy.ros.messages import Twist
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.envs.scene import make_scene
from tb2rl.robots.robot import find_robot
from tb2rl.simulation import find_simulator
from tb2rl.tasks.wander import Wander
from tb2rl.worlds import World

RADIUS = 1.4
WALLS = [(0.0, 2.0, 4.0, 0.1, 0.0), (0.0, -2.0, 4.0, 0.1, 0.0), (2.0, 0.0, 0.1, 4.0, 0.0), (-2.0, 0.0, 0.1, 4.0, 0.0)]


def drive(delay=0, boxes=(), radius=RADIUS):
    """Drive until the end, with commands that take effect `delay` control steps late."""
    world = World.from_shapes("room", [*WALLS, *boxes], start=(0.0, 0.0, 0.5))
    scene = make_scene(Wander(start="fixed"), "raw").in_worlds((world,))
    robot = SimulatedRobot(scene, find_simulator("kinematic"), 0, 10.0, long_ticks=True)
    policy = CalibrationDrive(find_robot("turtlebot2"), radius)
    driver, commands, poses = Driver(policy), [(0.0, 0.0)] * delay, []
    driver.start()
    while not policy.done and len(poses) < 3000:
        driver.see_scan(robot.scan().to_scan(), 0.1 * len(poses))
        odometry = robot.odometry()
        driver.see_odometry(odometry.pose, odometry.twist, 0.1 * len(poses))
        command = driver.command(0.1 * len(poses))
        commands.append((command.v, command.w))
        robot.command(Twist(*commands[len(poses)]))
        robot.step()
        poses.append(odometry.pose)
    return SimpleNamespace(policy=policy, poses=np.array(poses), commands=np.array(commands), record=robot.record)


@pytest.mark.parametrize("delay", [0, 4])
def test_it_drives_every_manoeuvre_in_the_disc_and_ends(delay):
    found = drive(delay)
    assert found.policy.done
    assert not found.policy.problem
    assert 100.0 < 0.1 * len(found.poses) < 200.0
    assert np.hypot(*found.poses[:, :2].T).max() < RADIUS - 0.178
    assert found.record.contact_count == 0
    robot = find_robot("turtlebot2")
    assert found.commands[:, 0].min() == 0.0  # never backwards, where it sees nothing
    assert found.commands.max(axis=0) == pytest.approx(1.1 * np.array([robot.max_speed, robot.max_turn_rate]))
    assert found.commands[:, 1].min() == pytest.approx(-1.1 * robot.max_turn_rate)
    assert found.commands[-1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("angle", [0.0, math.pi])
def test_it_says_that_the_space_is_not_free_before_it_drives_a_line(angle):
    found = drive(boxes=[(1.1 * math.cos(angle), 1.1 * math.sin(angle), 0.2, 0.2, 0.0)])
    assert found.policy.done
    assert "obstacle nearer than 1.30 m to the start" in found.policy.problem
    assert (found.commands[:, 0] == 0.0).all()


def test_an_interruption_only_delays_it():
    policy = CalibrationDrive(find_robot("turtlebot2"))
    far = SimpleNamespace(ranges=np.full(121, np.inf), pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0))
    standing = [policy.act(far) for _ in range(20)]
    policy.reset()
    assert [*standing, *(policy.act(far) for _ in range(11))][-1] == (0.0, pytest.approx(0.8))  # after 3 s


def test_a_small_disc_is_refused():
    with pytest.raises(ValueError, match=r"at least 0\.9 m, got 0\.5"):
        CalibrationDrive(find_robot("turtlebot2"), 0.5)
