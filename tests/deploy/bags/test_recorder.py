"""A recorded episode holds what happened in it to the digit, in both formats, for every reader of bags."""

import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.core.errors import InputError, install_extra
from tb2rl.deploy.bags.recorder import START_TIME, open_bag
from tb2rl.deploy.bags.writing import checked_bag_path

highlevel = pytest.importorskip("rosbags.highlevel")


def read(path) -> dict[str, list]:
    """The content of a bag by the library's own reader: time [s] and message by topic."""
    found: dict[str, list] = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp / 1e9, message))
    return found


def test_the_librarys_own_reader_finds_the_episode_in_simulated_time(driven):  # see test_reading.py for the rest
    states, found = driven.robot_states, read(driven.path)
    scans = np.array([message.ranges for _, message in found["/kobuki/laser/scan"]])
    assert scans.tolist() == np.float32([each.ranges[0] for each in states]).tolist()
    assert [message.data for _, message in found["/reward"]] == driven.rewards
    assert [message.data for _, message in found["/bumper"]] == [bool(each.bumped[0]) for each in states]
    for (_, message), state in zip(found["/tf"], states, strict=True):
        links = [(each.header.frame_id, each.child_frame_id) for each in message.transforms]
        assert links == [("map", "odom"), ("odom", "base_footprint")]
        odom, base = (each.transform for each in message.transforms)
        (origin, turned), (moved, turn) = ((each.translation, each.rotation) for each in (odom, base))
        yaw = 2 * math.atan2(turned.z, turned.w)
        cos, sin, heading = math.cos(yaw), math.sin(yaw), yaw + 2 * math.atan2(turn.z, turn.w)
        x, y = origin.x + cos * moved.x - sin * moved.y, origin.y + sin * moved.x + cos * moved.y
        assert [x, y, math.sin(heading)] == pytest.approx([*state.pose[0, :2], math.sin(state.pose[0, 2])], abs=1e-9)
    times = [START_TIME + 0.2 * step for step in range(11)]
    age = 0.2 * float(driven.robot_states[0].initial_state.records["observation_latency"][0])
    late = {topic: [time + age for time in times] for topic in ("/odom", "/kobuki/laser/scan")}
    for topic, messages in found.items():
        expected = {"/cmd_vel": times[:-1], "/reward": times[1:], **late}.get(topic, times)
        assert [time for time, _ in messages] == pytest.approx(expected), topic
    stamps = [message.header.stamp for topic in ("/odom", "/kobuki/laser/scan") for _, message in found[topic]]
    stamps += [message.clock for _, message in found["/clock"]]
    assert [stamp.sec + stamp.nanosec / 1e9 for stamp in stamps] == pytest.approx(times * 3)


def test_a_contact_is_an_event_of_the_pressed_bumper(driven, tmp_path):
    bag, first, angles = tmp_path / driven.path.name, driven.robot_states[0], driven.scene.laser.angles
    left, middle = (np.where(np.abs(angles - a) == np.abs(angles - a).min(), 0.2, 3.0) for a in (1.0, 0.0))
    with open_bag(bag, driven.scene) as recorder:
        recorder.reset(first)
        for ranges, bumped in ((left, True), (left, True), (middle, True), (middle, False)):
            recorder.step(np.zeros(2), 0.0, replace(first, ranges=ranges[None], bumped=np.array([bumped])))
    events = read(bag)["/mobile_base/events/bumper" if bag.suffix else "/events/bumper"]
    assert [(event.bumper, event.state) for _, event in events] == [(0, 1), (0, 0), (1, 1), (1, 0)]
    assert [time for time, _ in events] == pytest.approx([1.2, 1.6, 1.6, 1.8])


@pytest.mark.parametrize(
    ("settings", "used", "step"),
    [
        ({"beams": 9, "beam_indices": [1, 2, 7]}, [1, 2, 7], math.pi / 8),
        ({"beams": 1}, [0], 0.0),
        ({"beams": 8, "robot": "turtlebot3", "field_of_view": math.tau}, range(8), math.pi / 4),
    ],
)
def test_a_scan_has_the_angles_of_the_laser_and_nan_for_unused_beams(settings, used, step, record, tmp_path):
    driven = record(tmp_path / "drive.bag", steps=1, **settings)
    _, scan = read(driven.path)["/kobuki/laser/scan"][0]
    assert len(scan.ranges) == settings["beams"]
    assert np.flatnonzero(~np.isnan(scan.ranges)).tolist() == list(used)
    assert scan.ranges[list(used)].tolist() == np.float32(driven.robot_states[0].ranges[0]).tolist()
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    assert angles[list(used)] == pytest.approx(driven.scene.laser.angles, abs=1e-6)
    assert (scan.angle_increment, scan.angle_max) == pytest.approx((step, angles[-1]), abs=1e-6)
    laser = driven.scene.robot.laser
    assert (scan.range_min, scan.range_max) == pytest.approx((laser.min_range, laser.max_range))


def test_a_goal_is_on_the_usual_topic_of_each_ros(bag, record):
    driven = record(bag, "wall", steps=2)
    ((_, goal),) = read(bag)["/move_base_simple/goal" if bag.suffix else "/goal_pose"]
    assert goal.header.frame_id == "map"
    assert [goal.pose.position.x, goal.pose.position.y] == driven.robot_states[0].goal[0].tolist()


def test_an_interrupted_bag_leaves_nothing_and_an_older_file_is_replaced(driven, tmp_path):
    bag, other = tmp_path / driven.path.name, tmp_path / "other.bag"
    other.write_text("older")
    with open_bag(other, driven.scene) as recorder:
        recorder.reset(driven.robot_states[0])
    with pytest.raises(KeyboardInterrupt), open_bag(bag, driven.scene):
        raise KeyboardInterrupt
    with pytest.raises(InputError, match=r"cannot write .*drive.*: No space left"), open_bag(bag, driven.scene):
        raise OSError(28, "No space left on device")
    assert [file.name for file in bag.parent.iterdir()] == ["other.bag"]
    assert len(read(other)["/odom"]) == 1


def test_an_invalid_path_or_a_missing_library_is_refused(tmp_path, monkeypatch):
    taken = tmp_path / "there.bag"
    taken.mkdir()
    for path, words in (
        (tmp_path / "drive.mcap", r"give a file NAME\.bag"),
        (taken, "cannot write"),
        (tmp_path, "exists already"),
        (tmp_path / "missing" / "drive", "choose a file in a writable folder"),
    ):
        with pytest.raises(InputError, match=words):
            checked_bag_path(path)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(InputError, match=re.escape(install_extra("bags"))):
        checked_bag_path(tmp_path / "drive.bag")
