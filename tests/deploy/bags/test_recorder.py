"""A recorded episode holds what happened in it to the digit, in both formats, for whoever reads bags."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError, install_extra
from tb2rl.deploy.bags.recorder import BEGIN, check_bag, open_bag

highlevel = pytest.importorskip("rosbags.highlevel")
STRAY = {"variation": "strong", "laser_noise": 0.01}  # odometry is not the truth


def said(path) -> dict[str, list]:
    """What the library's own reader finds in a bag: time [s] and message by topic."""
    found: dict[str, list] = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp / 1e9, message))
    return found


def pose_of(pose) -> list[float]:
    position = getattr(pose, "position", None) or pose.translation
    turned = getattr(pose, "orientation", None) or pose.rotation
    return [position.x, position.y, 2 * math.atan2(turned.z, turned.w)]


def turned(yaw: float) -> np.ndarray:
    return np.array([(math.cos(yaw), -math.sin(yaw)), (math.sin(yaw), math.cos(yaw))])


def same_poses(found, expected) -> None:
    found, expected = np.array(found), np.array(expected)
    assert found[:, :2] == pytest.approx(expected[:, :2], abs=1e-9)
    assert np.cos(found[:, 2] - expected[:, 2]) == pytest.approx(1.0, abs=1e-9)


def test_the_librarys_own_reader_finds_what_happened(bag, record):
    driven = record(bag, **STRAY)
    found = said(bag)
    assert len(driven.rewards) == 10
    for topic, poses, twists in (("/odom", "odometry", "odometry_twist"), ("/ground_truth", "pose", "twist")):
        messages = [message for _, message in found[topic]]
        same_poses([pose_of(each.pose.pose) for each in messages], [getattr(r, poses)[0] for r in driven.readings])
        moved = [(each.twist.twist.linear.x, each.twist.twist.angular.z) for each in messages]
        assert moved == [tuple(getattr(robot_state, twists)[0].tolist()) for robot_state in driven.readings]
    scans = np.array([message.ranges for _, message in found["/kobuki/laser/scan"]])
    assert scans.tolist() == np.float32([robot_state.ranges[0] for robot_state in driven.readings]).tolist()
    told = [(message.linear.x, message.angular.z) for _, message in found["/cmd_vel"]]
    assert told == [tuple(command) for command in driven.commands.tolist()]
    assert [message.data for _, message in found["/reward"]] == driven.rewards
    assert [message.data for _, message in found["/bumper"]] == [bool(r.bumped[0]) for r in driven.readings]


def test_a_touch_is_an_event_of_the_bumper_that_is_pressed(bag, record):
    driven = record(bag.with_name(f"other{bag.suffix}"))
    first, nothing = driven.readings[0], np.zeros(2)
    angles = driven.env.scene.laser.angles
    left, middle = (np.where(np.isclose(angles, angles[np.abs(angles - a).argmin()]), 0.2, 3.0) for a in (1.0, 0.0))
    with open_bag(bag, driven.env.scene) as recorder:
        recorder.begin(first)
        for ranges, bumped in ((left, True), (left, True), (middle, True), (middle, False)):
            recorder.step(nothing, 0.0, replace(first, ranges=ranges[None], bumped=np.array([bumped])))
    events = said(bag)["/mobile_base/events/bumper" if bag.suffix else "/events/bumper"]
    assert [(event.bumper, event.state) for _, event in events] == [(0, 1), (0, 0), (1, 1), (1, 0)]
    assert [time for time, _ in events] == pytest.approx([1.2, 1.6, 1.6, 1.8])


def test_every_stamp_is_in_simulated_time_and_commands_come_before_their_step(bag, record):
    found = said(record(bag).path)
    times = [BEGIN + 0.2 * step for step in range(11)]
    for topic, messages in found.items():
        expected = {"/cmd_vel": times[:-1], "/reward": times[1:]}.get(topic, times)
        assert [time for time, _ in messages] == pytest.approx(expected), topic
    for topic in ("/odom", "/ground_truth", "/kobuki/laser/scan"):
        stamps = [message.header.stamp for _, message in found[topic]]
        assert [stamp.sec + stamp.nanosec / 1e9 for stamp in stamps] == pytest.approx(times), topic
    assert [message.clock.sec + message.clock.nanosec / 1e9 for _, message in found["/clock"]] == pytest.approx(times)


def test_the_transforms_lead_from_the_map_to_where_the_robot_truly_is(bag, record):
    driven = record(bag, **STRAY)
    places = []
    for _, message in said(bag)["/tf"]:
        links = [(each.header.frame_id, each.child_frame_id) for each in message.transforms]
        assert links == [("map", "odom"), ("odom", "base_footprint")]
        (x, y, yaw), (dx, dy, turn) = (pose_of(each.transform) for each in message.transforms)
        places.append([*(np.array([x, y]) + turned(yaw) @ (dx, dy)), yaw + turn])
    same_poses(places, [robot_state.pose[0] for robot_state in driven.readings])


@pytest.mark.parametrize(
    ("settings", "read", "step"),
    [
        ({"beams": 9}, range(9), math.pi / 8),
        ({"beams": 9, "beam_indices": [1, 2, 7]}, [1, 2, 7], math.pi / 8),
        ({"beams": 1}, [0], 0.0),
        ({"beams": 8, "robot": "turtlebot3", "field_of_view": math.tau}, range(8), math.pi / 4),
    ],
)
def test_a_scan_says_where_its_beams_look_and_knows_nothing_of_those_not_read(settings, read, step, record, tmp_path):
    driven = record(tmp_path / "drive.bag", steps=1, **settings)
    _, scan = said(driven.path)["/kobuki/laser/scan"][0]
    assert len(scan.ranges) == settings["beams"]
    assert np.flatnonzero(~np.isnan(scan.ranges)).tolist() == list(read)
    assert scan.ranges[list(read)].tolist() == np.float32(driven.readings[0].ranges[0]).tolist()
    assert scan.angle_increment == pytest.approx(step)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    assert angles[list(read)] == pytest.approx(driven.env.scene.laser.angles, abs=1e-6)
    assert scan.angle_max == pytest.approx(angles[-1], abs=1e-6)
    laser = driven.env.scene.robot.laser
    assert (scan.range_min, scan.range_max) == pytest.approx((laser.min_range, laser.max_range))


@pytest.mark.parametrize(("name", "topic"), [("drive.bag", "/move_base_simple/goal"), ("drive", "/goal_pose")])
def test_a_goal_stands_where_the_tools_of_each_ros_look_for_it(name, topic, record, tmp_path):
    driven = record(tmp_path / name, "wall", steps=2)
    ((_, goal),) = said(driven.path)[topic]
    assert goal.header.frame_id == "map"
    assert [goal.pose.position.x, goal.pose.position.y] == driven.readings[0].goal[0].tolist()


def test_an_older_file_is_replaced_and_nothing_else_is_left(record, tmp_path):
    (tmp_path / "drive.bag").write_text("older")
    record(tmp_path / "drive.bag", steps=1)
    assert [file.name for file in tmp_path.iterdir()] == ["drive.bag"]
    assert len(said(tmp_path / "drive.bag")["/odom"]) == 2


def test_what_is_interrupted_leaves_nothing(bag, record, monkeypatch):
    scene = record(bag.with_name("other.bag"), steps=1).env.scene
    with pytest.raises(KeyboardInterrupt), open_bag(bag, scene):
        raise KeyboardInterrupt
    assert [file.name for file in bag.parent.iterdir()] == ["other.bag"]


def test_a_disk_that_is_full_is_one_line(bag, record):
    scene = record(bag.with_name("other.bag"), steps=1).env.scene
    with pytest.raises(InputError, match=r"cannot write .*drive.*: No space left"), open_bag(bag, scene):
        raise OSError(28, "No space left on device")
    assert [file.name for file in bag.parent.iterdir()] == ["other.bag"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("drive.mcap", "a bag is a file .bag"),
        ("there", "exists already"),
        ("there.bag", "exists already"),
        ("missing/drive", "its folder does not exist"),
        ("missing/drive.bag", "its folder does not exist"),
    ],
)
def test_a_path_that_cannot_be_a_bag_is_refused(name, words, tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "there.bag").mkdir()
    with pytest.raises(InputError, match=words):
        check_bag(tmp_path / name)


def test_without_the_library_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(InputError, match=re.escape(install_extra("bags"))):
        check_bag(tmp_path / "drive.bag")
