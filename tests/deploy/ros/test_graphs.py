"""`python -m tb2rl.ros simulate` on real graphs of ROS 1 and ROS 2: what programs of ROS hear, say and call there."""

from __future__ import annotations

import base64
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

import tb2rl
from tb2rl.deploy.ros.definitions import write_packages

pytestmark = pytest.mark.slow
SCAN, SCANS = "/kobuki/laser/scan", "sensor_msgs/LaserScan"
START = (-3.75, -3.75, 0.0)  # of the world `loop`
RATE = 2.0  # half the time, on a machine that may be busy
BUMPER = {"kobuki_msgs/msg/BumperEvent.msg": "uint8 bumper\nuint8 state\n"}


@pytest.fixture(scope="module")
def simulated(graph):
    """A robot that simulates in real time or faster, for all tests of what it says."""
    if graph.version == 1:
        write_packages(graph.folder / "messages", BUMPER)
    with graph.start("simulate", "--rate", str(RATE)) as process:
        yield process


@pytest.fixture
def probe(simulated, graph):
    """A node of a user's, and the robot at its start."""
    with graph.probe() as probe:
        probe.listen("/clock", "rosgraph_msgs/Clock")
        probe.listen("/odom", "nav_msgs/Odometry")
        probe.drive(0.0, 0.0)  # they are connected, and the next one is not late
        probe.drive(0.0, 0.0, topic="/cmd_vel_mux/input/navi")
        probe.call("/gazebo/unpause_physics")
        probe.call("/gazebo/reset_world")
        yield probe


def seconds(stamp):
    return stamp["sec"] + 1e-9 * stamp["nanosec"]


def place(odometry):
    position, turn = odometry["pose"]["pose"]["position"], odometry["pose"]["pose"]["orientation"]
    return position["x"], position["y"], 2 * math.atan2(turn["z"], turn["w"])


def test_scans_are_those_of_the_tutorials_laser_ten_times_a_second(probe):
    probe.listen(SCAN, SCANS)
    first, *_, last = probe.take(SCAN, count=5)
    assert len(first["ranges"]) == 720
    assert (first["angle_min"], first["angle_max"]) == pytest.approx((-math.pi / 2, math.pi / 2))
    assert first["angle_increment"] == pytest.approx(math.pi / 719)
    assert (first["range_min"], first["range_max"]) == pytest.approx((0.1, 30.0))
    assert first["header"]["frame_id"] == "laser_link"
    assert seconds(last["header"]["stamp"]) - seconds(first["header"]["stamp"]) == pytest.approx(0.4)
    env = tb2rl.make_env("maze", "raw", start="fixed", beams=720)
    env.reset(seed=0)
    np.testing.assert_allclose(first["ranges"], env.unwrapped.robot_state.ranges[0], atol=0.002)


def stands(odometry):
    twist = odometry["twist"]["twist"]
    return max(abs(twist["linear"]["x"]), abs(twist["angular"]["z"])) < 0.01


def driven(probe, linear, angular, **topic):
    """Odometry of every 0.025 s from before a command until the robot has obeyed it and stands again."""
    heard = probe.take("/odom")
    probe.drive(linear, angular, **topic)
    while stands(heard[-1]):  # a busy machine is late
        heard += probe.take("/odom", fresh=False)
        assert len(heard) < 1000, "it stands"
    while not stands(heard[-1]):
        heard += probe.take("/odom", fresh=False)
        assert len(heard) < 2000, "it does not stop after 0.6 s without a command"
    return heard


def back_at_the_start(probe):
    """The first odometry that says so."""
    for _ in range(200):
        (odometry,) = probe.take("/odom", fresh=False)
        if place(odometry) == pytest.approx(START, abs=0.01):
            return odometry
    raise AssertionError(odometry)


def test_odometry_begins_at_the_start_pose_and_follows_commands_until_they_stop(probe):
    odometry = back_at_the_start(probe)
    assert (odometry["header"]["frame_id"], odometry["child_frame_id"]) == ("odom", "base_footprint")
    straight = driven(probe, 0.5, 0.0)
    speeds = [each["twist"]["twist"]["linear"]["x"] for each in straight]
    assert max(speeds) == pytest.approx(0.5, abs=0.03)
    assert 0.25 < place(straight[-1])[0] - START[0] < 0.4
    turned = driven(probe, 0.0, 1.0, topic="/cmd_vel_mux/input/navi")
    assert max(each["twist"]["twist"]["angular"]["z"] for each in turned) == pytest.approx(1.0, abs=0.05)
    assert 0.4 < place(turned[-1])[2] < 0.8


def test_stamps_are_times_of_the_clock(probe):
    probe.take("/clock")
    odometry = [seconds(each["header"]["stamp"]) for each in probe.take("/odom", count=20)]
    clock = [0.0]
    while clock[-1] < odometry[-1]:
        clock += [seconds(each["clock"]) for each in probe.take("/clock", fresh=False)]
    assert np.diff(odometry) == pytest.approx(0.025)
    assert {round(stamp, 3) for stamp in odometry} <= {round(stamp, 3) for stamp in clock}


def test_a_pause_stops_the_clock_and_the_robot_until_it_ends(probe):
    probe.drive(0.5, 0.0)
    probe.call("/gazebo/pause_physics")
    assert probe.ask("count", topic="/clock", seconds=0.2) <= 2, "what was on its way"
    assert probe.ask("count", topic="/odom", seconds=0.5) == 0
    probe.call("/gazebo/unpause_physics")
    assert probe.take("/clock", count=3)


def test_resets_put_the_robot_back_and_one_of_them_the_clock(probe):
    moved = driven(probe, 0.5, 0.0)[-1]
    assert place(moved)[0] > START[0] + 0.2
    probe.call("/gazebo/reset_world")
    back = back_at_the_start(probe)
    assert seconds(back["header"]["stamp"]) > seconds(moved["header"]["stamp"])
    probe.call("/gazebo/reset_simulation")
    stamps = [seconds(each["header"]["stamp"]) for each in probe.take("/odom", count=40)]
    assert stamps[-1] < seconds(back["header"]["stamp"])


def test_the_camera_has_colours_and_depths(probe):
    probe.listen("/camera/rgb/image_raw", "sensor_msgs/Image")
    probe.listen("/camera/depth/image_raw", "sensor_msgs/Image")
    (colours,) = probe.take("/camera/rgb/image_raw")
    (depth,) = probe.take("/camera/depth/image_raw")
    assert (colours["encoding"], colours["height"], colours["width"], colours["step"]) == ("rgb8", 240, 320, 960)
    assert len(base64.b64decode(colours["data"])) == 240 * 960
    assert (depth["encoding"], depth["step"]) == ("32FC1", 1280)
    depths = np.frombuffer(base64.b64decode(depth["data"]), np.float32).reshape(240, 320)
    env = tb2rl.make_env("maze", "raw", start="fixed")
    env.reset(seed=0)
    np.testing.assert_allclose(depths, env.unwrapped.camera()[1], atol=0.05, rtol=0.05)


def test_frames_lead_from_odometry_to_laser_and_camera(probe, graph):
    if graph.version == 2:
        pytest.skip("tf2_msgs of ROS 2 is on robots alone: pip has no package of it")
    probe.listen("/tf", "tf2_msgs/TFMessage")
    (message,) = probe.take("/tf")
    frames = {each["child_frame_id"]: each["header"]["frame_id"] for each in message["transforms"]}
    assert frames["base_footprint"] == "odom"
    assert frames["laser_link"] == frames["camera_rgb_optical_frame"] == "base_footprint"
    where = message["transforms"][0]["transform"]["translation"]
    assert (where["x"], where["y"]) == pytest.approx(START[:2], abs=0.01)


CALLBACK = """
import sys, threading
from tb2rl.deploy.ros.graph import join
from tb2rl.deploy.ros.messages import Odometry

graph, heard, again = join(int(sys.argv[1]), "listener"), [], threading.Event()

def hear(odometry):
    heard.append(odometry)
    if len(heard) == 1:
        raise OverflowError("a number is too large")
    again.set()

graph.listen("/odom", Odometry, hear)
print(again.wait(20.0))
graph.close()
"""


def test_an_error_in_a_callback_does_not_end_the_thread_that_calls_it(simulated, graph):
    command = [str(graph.python), "-c", CALLBACK, str(graph.version)]
    env = {**graph.env, "PYTHONPATH": str(Path(tb2rl.__file__).parents[1])}
    done = subprocess.run(command, env=env, cwd=graph.folder, capture_output=True, text=True, check=False)
    assert done.stdout == "True\n", done.stderr
    assert "a number is too large" in done.stderr


def test_a_wall_presses_the_bumper(probe, graph):
    if graph.version == 2:
        pytest.skip("kobuki_ros_interfaces is on robots alone: pip has no package of it")
    probe.listen("/mobile_base/events/bumper", "kobuki_msgs/BumperEvent")
    event = probe.ask("drive_until", topic="/cmd_vel", linear=0.6, angular=0.0, heard="/mobile_base/events/bumper")
    assert event == {"bumper": 1, "state": 1}


def test_programs_are_told_that_time_is_simulated(probe, graph):
    if graph.version == 2:
        pytest.skip("in ROS 2 each program is told by itself")
    assert probe.ask("parameter", name="/use_sim_time") is True
