"""The command `ros`: errors are one line, and only the requested ROS is imported."""

import math
from importlib.util import find_spec

import pytest

from tb2rl.core.errors import install_extra
from tb2rl.deploy import Mounting
from tb2rl.deploy.ros.robot import parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, Topics, parse_topics
from tb2rl.ros import main


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["simulate", "messages"]),
        ("drive zoo:maze-loop-pop", ["unknown zoo policy", "maze-loop-ppo"]),
        ("drive zoo:maze-loop-ppo --speed nan", ["--speed", "finite", "nan"]),
        ("drive zoo:maze-loop-ppo --mounting 0.1,0", ["--mounting", "x,y,yaw", "'0.1,0'"]),
        ("drive zoo:maze-loop-ppo --topics scan", ["--topics", "KEY=TOPIC"]),
        ("drive zoo:maze-loop-ppo --topics navigation=/x", ["--topics", "velocity"]),
        ("drive zoo:maze-loop-ppo --ros-args -p use_sim_time:=true", ["--ros-args", "--ros 2"]),
        ("simulate --ros 2 --scan-rate 1", ["--scan-rate", "2", "got 1"]),
        ("simulate --ros 2 --lockstep 0", ["--lockstep", "greater than 0"]),
        ("simulate --ros 1 --topics scn=/scan", ["did you mean 'scan'", "odometry"]),
        ("simulate --ros 1 --topics 'scan=/my scan'", ["--topics.scan", "pattern"]),
        ("simulate --ros 1 --task wal", ["did you mean 'wall'"]),
        ("simulate --ros 1 --simulation gazebo", ["unknown simulator 'gazebo'", "kinematic"]),
    ],
)
def test_wrong_arguments_are_one_line(line, named, refused):
    refused(main, line, named)


def test_without_ros_a_line_says_how_to_install_it(tmp_path, monkeypatch, refused):
    if find_spec("rospy") or find_spec("rclpy"):
        pytest.skip("this Python has ROS")
    monkeypatch.setattr("tb2rl.deploy.ros.debian.PACKAGES", tmp_path)
    refused(main, "simulate --ros 1", ["rospy", "apt-get install", "python3-rospy"])
    refused(main, "simulate --ros 2", ["rclpy", install_extra("ros2")])


def test_topics_mountings_and_limits_are_parsed():
    assert parse_topics(["scan=/scan", "odometry=robot/odom"], Topics()) == Topics(scan="/scan", odometry="robot/odom")
    assert parse_topics(["scan=/laser"], TURTLEBOT2[2]).velocity == "/cmd_vel"
    assert parse_mounting("-0.1,0,1.5") == Mounting(-0.1, 0.0, 1.5)
    assert parse_mounting("0,0.2,0,upside-down") == Mounting(0.0, 0.2, 0.0, upside_down=True)
    assert [parse_limits(speed).speed for speed in (None, 0.3)] == [math.inf, 0.3]


@pytest.mark.slow
def test_without_a_master_it_ends_with_one_line(graph1, monkeypatch):
    monkeypatch.setitem(graph1.env, "ROS_MASTER_URI", "http://127.0.0.1:9")
    with graph1.command("ros", "simulate", "--ros", "1") as simulated:
        assert simulated.wait() == 2
    (line,) = simulated.errors
    assert line.startswith("error: no ROS master answers at http://127.0.0.1:9: start one with `rosmaster --core`")
