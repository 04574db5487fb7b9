"""Bags of any robot become drives; a broken or foreign file ends in one line."""

import math
from pathlib import Path

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.deploy.bags import reading
from tb2rl.deploy.bags.messages import BUMPER_EVENTS
from tb2rl.deploy.bags.reading import Drive, is_bag, read_drive
from tb2rl.deploy.ros.messages import Twist

pytest.importorskip("rosbags")


@pytest.fixture
def foreign(write, messages) -> Path:
    """A robot that drives 2 m ahead in two seconds, with its own topic names."""
    content = []
    for step in range(11):
        time = 1e9 + 0.2 * step  # [s] of a real clock
        content += [
            (time, "/robot/wheels", messages.odometry(0.2 * step, v=1.0, w=0.1)),
            (time, "/robot/front", messages.scan(0.0, 0.05, math.nan, 5.0 - 0.2 * step, math.inf, 40.0)),
            (time, "/robot/drive", Twist(1.1, 0.2).to_ros(messages)),
        ]
    content.append((time, "/robot/filtered", messages.odometry(7.0)))
    return write(content)


def refused(path: Path, words: str, topics=None) -> None:
    with pytest.raises(InputError, match=words) as stopped:
        read_drive(path, topics or {})
    assert "\n" not in str(stopped.value)
    assert str(path) in str(stopped.value)


def test_an_episode_reads_back_as_it_was_driven(driven):
    drive = read_drive(driven.path, {}, scans=True)
    states = driven.robot_states
    age = 0.2 * float(states[0].initial_state.records["observation_latency"][0])
    for rows, poses, twists in ((drive.odometry, "odometry", "odometry_twist"), (drive.truth, "pose", "twist")):
        assert rows[:, 6] == pytest.approx(age if poses == "odometry" else 0.0, abs=1e-9)
        assert rows[:, 0] - rows[:, 6] == pytest.approx(0.2 * np.arange(len(states)), abs=1e-9)
        assert rows[:, 1:4] == pytest.approx(np.array([getattr(each, poses)[0] for each in states]), abs=1e-9)
        assert rows[:, 4:6].tolist() == [getattr(each, twists)[0].tolist() for each in states]
    assert drive.commands[:, 1:].tolist() == driven.commands.tolist()
    assert drive.scan_minima[:, 1].tolist() == [float(np.float32(each.nearest_range[0])) for each in states]
    assert drive.scans.times == pytest.approx(0.2 * np.arange(len(states)), abs=1e-9)
    assert drive.scans.ages == pytest.approx(age, abs=1e-9)
    assert drive.scans.ranges.tolist() == np.float32([each.ranges[0] for each in states]).tolist()
    assert drive.scans.angles == pytest.approx(driven.scene.laser.angles, abs=1e-6)
    assert drive.trajectory is drive.truth
    assert (drive.distance, drive.seconds) == pytest.approx((driven.distance, 2.0), abs=1e-9)
    assert drive.contacts == 0


@pytest.mark.parametrize("kobuki", [False, True])
def test_a_contact_counts_once_however_long_it_lasts(kobuki, bag, write, messages):
    topic, kind, field = "/bumper", "std_msgs/msg/Bool", "data"
    if kobuki:
        topic = "/mobile_base/events/bumper" if bag.suffix else "/events/bumper"
        kind, field = BUMPER_EVENTS[messages.ros], "state"
    content = [(1.0, "/odom", messages.odometry(0.0))]
    content += [(1.0 + i, topic, messages(kind, **{field: state})) for i, state in enumerate([1, 1, 0, 0, 1])]
    drive = read_drive(write(content), {})
    assert (drive.topics["bumper"], drive.contacts) == (topic, 2)


def test_topics_are_found_by_type_or_chosen_by_name(foreign):
    drive = read_drive(foreign, {})
    assert drive.topics == {"odom": "/robot/wheels", "scan": "/robot/front", "cmd_vel": "/robot/drive"}
    assert (drive.distance, drive.seconds, drive.speed, drive.min_range) == pytest.approx((2.0, 2.0, 1.0, 3.0))
    assert drive.contacts is None
    assert drive.commands[:, 1:].tolist() == [[1.1, 0.2]] * 11
    assert drive.trajectory[:, 4:6].tolist() == [[1.0, 0.1]] * 11
    assert read_drive(foreign, {"odom": "/robot/filtered"}).odometry[:, 1].tolist() == [7.0]
    refused(foreign, "no topic /x of type nav_msgs.*; odom can be: /robot/filtered, /robot/wheels", {"odom": "/x"})
    if not foreign.suffix:
        (mcap,) = foreign.glob("*.mcap")
        assert (is_bag(foreign), is_bag(mcap), is_bag(foreign.parent)) == (True, True, False)
        assert read_drive(mcap, {}).distance == drive.distance


def test_a_usual_topic_name_is_preferred_and_stamped_commands_are_read(write, messages):
    stamped = messages("geometry_msgs/msg/TwistStamped", twist=Twist(0.3, -0.5).to_ros(messages))
    content = [(1.0 + i, "/visual", messages.odometry(5.0)) for i in range(3)]
    content += [(1.0, "odom", messages.odometry(1.0)), (1.0, "/cmd_vel", stamped)]
    drive = read_drive(write(content), {})
    assert drive.topics["odom"] == "odom"
    assert drive.commands.tolist() == [[0.0, 0.3, -0.5]]


def test_a_path_is_rotated_to_begin_at_a_pose():
    rows, nothing = np.zeros((2, 6)), np.empty((0, 3))
    rows[:, 1:4] = (5.0, 5.0, math.pi / 2), (5.0, 7.0, math.pi / 2)
    drive = Drive("it", {}, rows, nothing, nothing, nothing, nothing, nothing)
    assert drive.path_from((1.0, 2.0, math.pi)) == pytest.approx(np.array([(1.0, 2.0), (-1.0, 2.0)]))


def test_a_bag_without_odometry_is_refused(write, messages):
    without = write([(1.0, "/scan", messages.scan(1.0))])
    refused(without, r"has no odometry.*topics: /scan \(sensor_msgs/msg/LaserScan")


@pytest.mark.parametrize("valid", [False, True])
def test_invalid_poses_are_left_out(valid, write, messages):
    content = [(1.0, "/odom", messages.odometry(x)) for x in (math.nan, math.inf, 1e300)]
    if not valid:
        refused(write(content), "the odometry has no valid pose")
        return
    content.append((2.0, "/odom", messages.odometry(3.0)))
    assert read_drive(write(content), {}).trajectory[:, 1].tolist() == [3.0]


@pytest.mark.parametrize("text", ["float64 x\nfloat64 y\n", "$(rm -rf /)"])
def test_another_definition_of_a_message_is_refused(text, write, messages):
    written = write([(1.0, "/odom", messages.odometry(1.0))], {"nav_msgs/msg/Odometry": text})
    refused(written, "nav_msgs/msg/Odometry on /odom is defined differently from ROS|cannot")


def test_definitions_of_messages_that_are_not_read_do_not_matter(write, messages):
    content = [(1.0, "/odom", messages.odometry(1.0)), (1.0, "/other", messages("std_msgs/msg/Bool", data=True))]
    assert len(read_drive(write(content, {"std_msgs/msg/Bool": "uint9 data"}), {}).trajectory) == 1


def test_a_bag_with_too_many_messages_is_refused(foreign, monkeypatch):
    monkeypatch.setattr(reading, "MAX_MESSAGES", 30)
    refused(foreign, "more than 30 messages on /robot/wheels, /robot/front, /robot/drive")


def test_a_file_that_is_no_bag_or_ends_early_is_refused(foreign, tmp_path):
    for ending in ("bag", "mcap", "db3"):
        refused(tmp_path / f"missing.{ending}", "there is no bag")
        (tmp_path / f"text.{ending}").write_text("no bag\n" * 100)
        refused(tmp_path / f"text.{ending}", "cannot read the bag")
    (tmp_path / "folder.bag").mkdir()
    refused(tmp_path / "folder.bag", "cannot read the bag")
    file = next(foreign.glob("*.mcap"), foreign)
    content = file.read_bytes()
    for share in (0.999, 0.3, 0.0):
        file.write_bytes(content[: int(share * len(content))])
        refused(foreign, "cannot read the bag")
