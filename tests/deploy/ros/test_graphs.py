"""`python -m tb2rl.ros simulate` on real graphs of ROS 1 and ROS 2: its topics, services and parameters."""

import base64
import math
import shutil
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

import tb2rl
from tb2rl.deploy.ros.debian import INTERFACES, write_packages

pytestmark = pytest.mark.slow
SCAN, SCANS = "/kobuki/laser/scan", "sensor_msgs/LaserScan"
START = (-3.75, -3.75, 0.0)  # of the world `loop`
RATE = 2.0  # half the time, on a machine that may be busy


@pytest.fixture(scope="module")
def connected(graph):
    """A node that receives and publishes, beside a simulation for all tests of this module."""
    if graph.version == 1:
        shutil.copytree(INTERFACES / "kobuki_msgs", graph.folder / "interfaces" / "kobuki_msgs")
        write_packages(graph.folder / "messages", graph.folder / "interfaces")
    with ExitStack() as stack:
        stack.enter_context(graph.start("simulate", "--rate", str(RATE)))
        if graph.version == 1:
            write_packages(graph.folder / "messages")  # for the probe; the simulation has made its own
        probe = stack.enter_context(graph.probe())
        probe.subscribe("/clock", "rosgraph_msgs/Clock")
        probe.subscribe("/odom", "nav_msgs/Odometry")
        probe.subscribe(SCAN, SCANS)
        for topic in ("/cmd_vel", "/cmd_vel_mux/input/navi"):
            probe.drive(0.0, 0.0, topic)
        yield probe


@pytest.fixture
def probe(connected):
    """This node, with the robot at its start."""
    connected.call("/gazebo/reset_world")
    odometry_at_the_start(connected)
    return connected


def seconds(stamp):
    return stamp["sec"] + 1e-9 * stamp["nanosec"]


def pose(odometry):
    position, turn = odometry["pose"]["pose"]["position"], odometry["pose"]["pose"]["orientation"]
    return position["x"], position["y"], 2 * math.atan2(turn["z"], turn["w"])


def speeds(odometry):
    twist = odometry["twist"]["twist"]
    return twist["linear"]["x"], twist["angular"]["z"]


def odometry_at_the_start(probe):
    """The first odometry message at the start."""
    for fresh in (True, *[False] * 200):
        (odometry,) = probe.take("/odom", fresh=fresh)
        if pose(odometry) == pytest.approx(START, abs=0.01):
            return odometry
    raise AssertionError(odometry)


def drive(probe, linear, angular, **topic):
    """Odometry of every 0.025 s from before a command until the robot has executed it and stands again."""
    received = probe.take("/odom")
    probe.drive(linear, angular, **topic)
    moved = False
    while not moved or max(map(abs, speeds(received[-1]))) > 0.01:
        received += probe.take("/odom", fresh=False)
        moved |= max(map(abs, speeds(received[-1]))) > 0.01
        assert len(received) < 2000, "it does not move, or does not stop after 0.6 s without a command"
    return received


def test_scans_are_those_of_the_tutorials_laser_ten_times_a_second(probe):
    first, *_, last = probe.take(SCAN, count=5)
    assert (len(first["ranges"]), first["header"]["frame_id"]) == (720, "laser_link")
    values = [first[name] for name in ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")]
    assert values == pytest.approx([-math.pi / 2, math.pi / 2, math.pi / 719, 0.1, 30.0])
    assert seconds(last["header"]["stamp"]) - seconds(first["header"]["stamp"]) == pytest.approx(0.4)


def test_odometry_follows_commands_until_they_stop_and_reset_world_puts_the_robot_back(probe):
    odometry = odometry_at_the_start(probe)
    assert (odometry["header"]["frame_id"], odometry["child_frame_id"]) == ("odom", "base_footprint")
    straight = drive(probe, 0.5, 0.0)
    assert max(speeds(each)[0] for each in straight) == pytest.approx(0.5, abs=0.03)
    assert 0.25 < pose(straight[-1])[0] - START[0] < 0.4
    turned = drive(probe, 0.0, 1.0, topic="/cmd_vel_mux/input/navi")
    assert max(speeds(each)[1] for each in turned) == pytest.approx(1.0, abs=0.05)
    assert 0.4 < pose(turned[-1])[2] < 0.8
    for service in ("pause_physics", "reset_world", "unpause_physics"):  # as the tutorial begins an episode
        probe.call(f"/gazebo/{service}")
    assert seconds(odometry_at_the_start(probe)["header"]["stamp"]) > seconds(turned[-1]["header"]["stamp"])


def test_stamps_are_times_of_the_clock_which_services_stop_and_set_back(probe):
    probe.take("/clock")
    odometry = [seconds(each["header"]["stamp"]) for each in probe.take("/odom", count=20)]
    clock = [0.0]
    while clock[-1] < odometry[-1]:
        clock += [seconds(each["clock"]) for each in probe.take("/clock", fresh=False)]
    assert np.diff(odometry) == pytest.approx(0.025)
    assert {round(stamp, 3) for stamp in odometry} <= {round(stamp, 3) for stamp in clock}
    probe.call("/gazebo/pause_physics")
    assert probe.count(topic="/clock", seconds=0.2) <= 2, "messages that were on their way"
    assert probe.count(topic="/odom", seconds=0.5) == 0
    probe.call("/gazebo/unpause_physics")
    probe.call("/gazebo/reset_simulation")
    assert seconds(probe.take("/clock", count=40)[-1]["clock"]) < clock[-1]


def test_the_camera_has_colours_and_depths(probe):
    probe.subscribe("/camera/rgb/image_raw", "sensor_msgs/Image")
    probe.subscribe("/camera/depth/image_raw", "sensor_msgs/Image")
    (colours,), (depth,) = probe.take("/camera/rgb/image_raw"), probe.take("/camera/depth/image_raw")
    shapes = [[image[name] for name in ("encoding", "height", "width", "step")] for image in (colours, depth)]
    assert shapes == [["rgb8", 240, 320, 960], ["32FC1", 240, 320, 1280]]
    assert len(base64.b64decode(colours["data"])) == 240 * 960
    depths = np.frombuffer(base64.b64decode(depth["data"]), np.float32)
    assert len(depths) == 240 * 320
    assert 0.2 < depths.min() < np.median(depths) < 10.0


def test_ros1_has_transforms_bumper_events_physics_properties_and_a_parameter_for_simulated_time(probe, graph):
    if graph.version == 2:
        pytest.skip("tf2_msgs and kobuki_ros_interfaces are on robots alone, and each node has its own use_sim_time")
    assert probe.parameter(name="/use_sim_time") is True
    assert probe.call("/gazebo/set_physics_properties", "gazebo_msgs/SetPhysicsProperties") == [True, ""]
    probe.subscribe("/tf", "tf2_msgs/TFMessage")
    (message,) = probe.take("/tf")
    frames = {each["child_frame_id"]: each["header"]["frame_id"] for each in message["transforms"]}
    on_base = dict.fromkeys(("laser_link", "camera_rgb_optical_frame"), "base_footprint")
    assert frames == {"base_footprint": "odom", **on_base}
    translation = message["transforms"][0]["transform"]["translation"]
    assert (translation["x"], translation["y"]) == pytest.approx(START[:2], abs=0.01)
    probe.subscribe("/mobile_base/events/bumper", "kobuki_msgs/BumperEvent")
    event = probe.drive(0.6, 0.0, until="/mobile_base/events/bumper")
    assert event == {"bumper": 1, "state": 1}


IMPORTS = """
from controller_manager_msgs.srv import SwitchController
from gazebo_msgs.msg import ODEPhysics
from gazebo_msgs.srv import SetPhysicsProperties
from kobuki_msgs.msg import BumperEvent, ButtonEvent, CliffEvent, WheelDropEvent
from openai_ros.msg import RLExperimentInfo
from openai_ros.robot_gazebo_env import RobotGazeboEnv

for each in (SetPhysicsProperties, BumperEvent, ButtonEvent, CliffEvent, WheelDropEvent):
    print(each._md5sum)
"""
CHECKSUMS = [  # of these interfaces, wherever they were made: nodes with other ones do not connect
    "97e2057080558ce4730434b5fae75c91",
    "ffe360cd50f14f9251d9844083e72ac5",
    "49eca512765dbdec759a79083ffcec8d",
    "c5b106efbb1427a94f517c5e05f06295",
    "e102837d89384d67669a0df86b63f33b",
]


def test_the_tutorials_programs_find_their_messages_beside_its_own_package_and_the_kobukis(graph1):
    with graph1.command("ros", "messages", "written") as written:  # as FROM_ROS.md says
        assert written.wait() == 0, written.errors
    tutorial = graph1.folder / "src" / "openai_ros"
    tutorial.mkdir(parents=True)
    (tutorial / "__init__.py").touch()
    (tutorial / "robot_gazebo_env.py").write_text("class RobotGazeboEnv: pass\n")
    path = f"{graph1.folder / 'written'}:{tutorial.parent}"
    with graph1.process(["/usr/bin/python3", "-c", IMPORTS], path) as program:
        assert program.wait() == 0, program.errors
    assert program.lines == CHECKSUMS


CALLBACK = """
import sys, time
from tb2rl.deploy.ros import create_node
from tb2rl.deploy.ros.messages import Odometry

node, received = create_node(int(sys.argv[1]), "listener"), []
node.create_subscription("/odom", Odometry, lambda odometry: received.append(odometry) or 1 / 0)
while len(received) < 2:
    time.sleep(0.01)
node.close()
"""


def test_an_error_in_a_callback_does_not_end_the_thread_that_calls_it(connected, graph):
    command = [graph.python, "-c", CALLBACK, str(graph.version)]
    with graph.process(command, str(Path(tb2rl.__file__).parents[1])) as listener:
        assert listener.wait() == 0
    assert "division by zero" in "\n".join(listener.errors)
