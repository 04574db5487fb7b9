"""The command `ros`: errors are one line, and only the requested ROS is imported."""

from __future__ import annotations

import shlex
import subprocess
import sys
from importlib.util import find_spec

import pytest

from tb2rl.core.errors import install_extra
from tb2rl.deploy import Limits, Mounting
from tb2rl.deploy.ros.robot import parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, Topics, parse_topics
from tb2rl.ros import main

MD5 = "97e2057080558ce4730434b5fae75c91"  # of gazebo_msgs/SetPhysicsProperties, wherever it was made
FIELDS = ["int32", "episode_number", "float32", "episode_reward"]  # of openai_ros/RLExperimentInfo
IMPORTED = """
import sys
from tb2rl.ros import main
try:
    main(sys.argv[1:])
finally:
    print(*[name for name in ("rospy", "rclpy") if name in sys.modules])
"""


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", ["simulate", "messages"]),
        ("simulate", ["--ros"]),
        ("drive", ["policy"]),
        ("drive zoo:maze-loop-pop", ["unknown zoo policy", "maze-loop-ppo"]),
        ("drive zoo:maze-loop-ppo --ros 3", ["--ros", "1, 2"]),
        ("drive zoo:maze-loop-ppo --speed nan", ["--speed", "finite", "nan"]),
        ("drive zoo:maze-loop-ppo --mounting 0.1,0", ["--mounting", "x,y,yaw", "'0.1,0'"]),
        ("drive zoo:maze-loop-ppo --mounting 0,0,nan", ["--mounting"]),
        ("drive zoo:maze-loop-ppo --topics scan", ["--topics", "KEY=TOPIC"]),
        ("drive zoo:maze-loop-ppo --topics navigation=/x", ["--topics", "velocity"]),
        ("drive zoo:maze-loop-ppo --ros-args -p use_sim_time:=true", ["--ros-args", "--ros 2"]),
        ("simulate --ros 1 --rate -1", ["--rate", "-1"]),
        ("simulate --ros 2 --scan-rate 1", ["--scan-rate", "2", "got 1"]),
        ("simulate --ros 2 --lockstep 0", ["--lockstep", "greater than 0"]),
        ("simulate --ros 2 --seed -1", ["--seed", "-1"]),
        ("simulate --ros 1 --topics scn=/scan", ["did you mean 'scan'", "odometry"]),
        ("simulate --ros 1 --topics 'scan=/my scan'", ["--topics.scan", "name of a topic"]),
        ("simulate --ros 1 --task wal", ["did you mean 'wall'"]),
        ("simulate --ros 1 --set task.world=lop", ["did you mean 'loop'"]),
        ("simulate --ros 1 --simulation gazebo", ["--simulation", "kinematic"]),
    ],
)
def test_wrong_arguments_are_one_line(line, named, capsys):
    assert_refused(line, named, capsys)


def assert_refused(line, named, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(shlex.split(line))
    message = capsys.readouterr().err
    assert (stopped.value.code, message.count("\n")) == (2, 1)
    assert [part for part in named if part not in message] == [], message


def test_without_ros_a_line_says_how_to_install_it(tmp_path, monkeypatch, capsys):
    if find_spec("rospy") or find_spec("rclpy"):
        pytest.skip("this Python has ROS")
    monkeypatch.setattr("tb2rl.deploy.ros.debian.PACKAGES", tmp_path)
    assert_refused("simulate --ros 1", ["rospy", "apt-get install", "python3-rospy"], capsys)
    assert_refused("simulate --ros 2", ["rclpy", install_extra("ros2")], capsys)


def test_topics_mountings_and_limits_are_parsed():
    assert parse_topics(["scan=/scan", "odometry=robot/odom"], Topics()) == Topics(scan="/scan", odometry="robot/odom")
    assert parse_topics(["scan=/laser"], TURTLEBOT2[2]).velocity == "/cmd_vel"
    assert parse_mounting("-0.1,0,1.5") == Mounting(-0.1, 0.0, 1.5)
    assert parse_mounting("0,0.2,0,upside-down") == Mounting(0.0, 0.2, 0.0, upside_down=True)
    assert parse_limits(None) == Limits()
    assert parse_limits(0.3) == Limits(speed=0.3)


@pytest.mark.slow
def test_without_a_master_it_ends_with_one_line_and_imports_no_other_ros(graph1):
    nowhere = {**graph1.env, "ROS_MASTER_URI": "http://127.0.0.1:9"}
    command = [sys.executable, "-c", IMPORTED, "simulate", "--ros", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=nowhere)
    assert done.returncode == 2
    assert done.stderr.startswith(
        "error: no ROS master answers at http://127.0.0.1:9: start one with `rosmaster --core`"
    )
    assert (done.stderr.count("\n"), done.stdout) == (1, "rospy\n")


@pytest.mark.slow
def test_messages_that_debian_lacks_are_written_for_programs_of_the_tutorial(graph1, tmp_path):
    command = [sys.executable, "-m", "tb2rl.ros", "messages", str(tmp_path / "made")]
    subprocess.run(command, check=True, env=graph1.env)
    (tmp_path / "program.py").write_text(
        "from gazebo_msgs.msg import ODEPhysics\n"
        "from gazebo_msgs.srv import SetPhysicsProperties, SetPhysicsPropertiesRequest\n"
        "from controller_manager_msgs.srv import SwitchController\n"
        "from openai_ros.msg import RLExperimentInfo\n"
        "import openai_ros.robot_gazebo_env  # of the tutorial: the written package does not shadow its own\n"
        "print(SetPhysicsProperties._md5sum, RLExperimentInfo._full_text.split())\n"
    )
    tutorial = tmp_path / "src" / "openai_ros"
    tutorial.mkdir(parents=True)
    for module in ("__init__.py", "robot_gazebo_env.py"):
        (tutorial / module).touch()
    path = {**graph1.env, "PYTHONPATH": f"{tmp_path / 'made'}:{tmp_path / 'src'}"}
    program = ["/usr/bin/python3", str(tmp_path / "program.py")]
    done = subprocess.run(program, capture_output=True, text=True, check=False, env=path)
    assert done.stdout.split(maxsplit=1) == [MD5, f"{FIELDS}\n"], done.stderr
