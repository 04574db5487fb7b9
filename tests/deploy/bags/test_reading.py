"""Bags of anybody's robot become drives, and files of strangers end in a drive or in one line."""

from __future__ import annotations

import bz2
import math
import random
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.deploy.bags import reading
from tb2rl.deploy.bags.drive import Drive
from tb2rl.deploy.bags.reading import is_bag, read_drive
from tb2rl.deploy.bags.topics import BUMPER_EVENTS

pytest.importorskip("rosbags")


@pytest.fixture
def stranger(bag, write, messages) -> Path:
    """A robot that drives 2 m ahead in two seconds, with topics of its own names."""
    new = messages(bag.suffix == ".bag")
    said = []
    for step in range(11):
        time = 1e9 + 0.2 * step  # [s] of a real clock
        said += [
            (time, "/robot/wheels", new.odometry(x=0.2 * step, v=1.0, w=0.1)),
            (time, "/robot/front", new.scan(0.0, 0.05, math.nan, 5.0 - 0.2 * step, math.inf, 40.0)),
            (time, "/robot/drive", new.twist(1.1, 0.2)),
        ]
    said.append((time, "/robot/filtered", new.odometry(x=7.0)))
    return write(bag, said)


# ---- what a drive holds


def test_an_episode_reads_back_as_it_was_driven(bag, record):
    driven = record(bag, variation="strong")
    drive = read_drive(bag, {})
    for rows, poses, twists in ((drive.odometry, "odometry", "odometry_twist"), (drive.truth, "pose", "twist")):
        readings = driven.readings
        assert rows[:, 0] == pytest.approx(0.2 * np.arange(len(readings)), abs=1e-9)
        assert rows[:, 1:4] == pytest.approx(np.array([getattr(each, poses)[0] for each in readings]), abs=1e-9)
        assert rows[:, 4:].tolist() == [getattr(each, twists)[0].tolist() for each in readings]
    assert drive.commands[:, 1:].tolist() == driven.commands.tolist()
    assert drive.nearest[:, 1].tolist() == [float(np.float32(each.nearest[0])) for each in driven.readings]
    assert drive.way is drive.truth
    assert drive.distance == pytest.approx(driven.distance, abs=1e-9)
    assert drive.seconds == pytest.approx(2.0, abs=1e-9)
    assert drive.touched == 0


def test_a_touch_is_counted_once_as_long_as_it_lasts(bag, write, messages):
    new = messages(bag.suffix == ".bag")
    said = [(1.0, "/odom", new.odometry(0.0))]
    said += [(1.0 + i, "/bumper", new("std_msgs/msg/Bool", data=touched)) for i, touched in enumerate([1, 1, 0, 0, 1])]
    assert read_drive(write(bag, said), {}).touched == 2


def test_the_bumper_events_of_a_kobuki_count(bag, write, messages):
    new = messages(bag.suffix == ".bag")
    ros1 = ("/mobile_base/events/bumper", BUMPER_EVENTS[1])
    topic, event = ros1 if bag.suffix else ("/events/bumper", BUMPER_EVENTS[2])
    said = [(1.0, "/odom", new.odometry(0.0))]
    said += [(2.0 + i, topic, new(event, bumper=1, state=state)) for i, state in enumerate([1, 0, 1, 0])]
    drive = read_drive(write(bag, said), {})
    assert (drive.topics["bumper"], drive.touched) == (topic, 2)


def test_a_robot_with_names_of_its_own_is_understood_by_types(stranger):
    drive = read_drive(stranger, {})
    assert drive.topics == {"odom": "/robot/wheels", "scan": "/robot/front", "cmd_vel": "/robot/drive"}
    assert (drive.distance, drive.seconds, drive.speed) == pytest.approx((2.0, 2.0, 1.0))
    assert drive.closest == pytest.approx(3.0)
    assert drive.touched is None
    assert drive.commands[:, 1:].tolist() == [[1.1, 0.2]] * 11
    assert drive.way[:, 4:].tolist() == [[1.0, 0.1]] * 11


def test_topics_can_be_named(stranger):
    drive = read_drive(stranger, {"odom": "/robot/filtered"})
    assert drive.odometry[:, 1].tolist() == [7.0]


def test_a_topic_of_a_usual_name_is_preferred_with_or_without_a_slash(tmp_path, write, messages):
    new = messages(first=True)
    said = [(1.0 + i, "/visual", new.odometry(5.0)) for i in range(3)] + [(1.0, "odom", new.odometry(1.0))]
    assert read_drive(write(tmp_path / "drive.bag", said), {}).topics == {"odom": "odom"}


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ({"odom": "/odometry"}, r"no topic /odometry of type nav_msgs.*; odom can be: /robot/filtered, /robot/wheels"),
        ({"scan": "/robot/wheels"}, r"no topic /robot/wheels of type sensor_msgs.*; scan can be: /robot/front"),
    ],
)
def test_a_topic_that_is_not_there_is_refused_with_those_that_are(topics, words, stranger):
    with pytest.raises(InputError, match=words):
        read_drive(stranger, topics)


def test_commands_with_a_stamp_are_read(tmp_path, write, messages):
    new = messages(first=False)
    stamped = new("geometry_msgs/msg/TwistStamped", twist=new.twist(0.3, -0.5))
    drive = read_drive(write(tmp_path / "drive", [(1.0, "/cmd_vel", stamped), (1.0, "/odom", new.odometry(0.0))]), {})
    assert drive.commands.tolist() == [[0.0, 0.3, -0.5]]


def test_an_mcap_file_without_its_folder_is_a_bag(stranger, tmp_path):
    if stranger.suffix:
        pytest.skip("the file of ROS 1 is one anyway")
    (alone,) = stranger.glob("*.mcap")
    assert is_bag(stranger)
    assert is_bag(alone)
    assert not is_bag(tmp_path)
    assert read_drive(alone, {}).distance == read_drive(stranger, {}).distance


def test_a_way_is_turned_to_begin_where_it_is_said_to():
    rows = np.array([(0.0, 5.0, 5.0, math.pi / 2, 0.0, 0.0), (1.0, 5.0, 7.0, math.pi / 2, 0.0, 0.0)])
    nothing = np.empty((0, 3))
    drive = Drive("it", {}, rows, nothing, nothing, nothing, nothing, nothing)
    assert drive.begun_at((1.0, 2.0, math.pi)) == pytest.approx(np.array([(1.0, 2.0), (-1.0, 2.0)]))


# ---- what is refused


def refused(path: Path, words: str, topics=None) -> None:
    with pytest.raises(InputError, match=words) as stopped:
        read_drive(path, topics or {})
    assert "\n" not in str(stopped.value)
    assert str(path) in str(stopped.value)


def test_a_bag_without_odometry_names_what_it_has(bag, write, messages):
    new = messages(bag.suffix == ".bag")
    refused(write(bag, [(1.0, "/scan", new.scan(1.0))]), r"has no odometry.*topics: /scan \(sensor_msgs/msg/LaserScan")


@pytest.mark.parametrize("place", [math.nan, math.inf, 1e300])
def test_a_place_that_is_nowhere_is_left_out(place, bag, write, messages):
    new = messages(bag.suffix == ".bag")
    said = [(1.0, "/odom", new.odometry(place)), (2.0, "/odom", new.odometry(3.0))]
    assert read_drive(write(bag, said), {}).way[:, 1].tolist() == [3.0]
    refused(write(bag.with_name(f"other{bag.suffix}"), said[:1]), "its odometry tells no place")


@pytest.mark.parametrize("text", ["float64 x\nfloat64 y\n", "string header\n" * 20_000, "$(rm -rf /)"])
def test_another_definition_of_a_message_is_refused_and_not_used(text, bag, write, messages):
    new = messages(bag.suffix == ".bag")
    written = write(bag, [(1.0, "/odom", new.odometry(1.0))], {"nav_msgs/msg/Odometry": text})
    refused(written, "nav_msgs/msg/Odometry on /odom is not the one of ROS|cannot|not a bag that can be read")


def test_definitions_of_what_is_not_read_do_not_matter(bag, write, messages):
    new = messages(bag.suffix == ".bag")
    said = [(1.0, "/odom", new.odometry(1.0)), (1.0, "/other", new("std_msgs/msg/Bool", data=True))]
    assert len(read_drive(write(bag, said, {"std_msgs/msg/Bool": "uint9 data"}), {}).way) == 1


def test_more_messages_than_anybody_looks_at_are_refused(stranger, monkeypatch):
    monkeypatch.setattr(reading, "MOST", 30)
    refused(stranger, "more than 30 messages on /robot/wheels, /robot/front, /robot/drive")


@pytest.mark.parametrize("name", ["missing.bag", "missing.mcap", "folder.bag", "text.bag", "text.mcap", "text.db3"])
def test_what_is_no_bag_is_refused(name, tmp_path):
    (tmp_path / "folder.bag").mkdir()
    for text in ("text.bag", "text.mcap", "text.db3"):
        (tmp_path / text).write_text("no bag\n" * 100)
    refused(tmp_path / name, "there is no bag|is not a bag that can be read")


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.999])
def test_a_bag_that_ends_early_is_refused(share, stranger):
    file = next(stranger.glob("*.mcap"), stranger)
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    refused(stranger, "is not a bag that can be read")


@pytest.mark.slow
def test_whatever_bytes_are_wrong_there_is_a_drive_or_one_line(stranger, tmp_path):
    draw, name = random.Random(0), f"it{stranger.suffix}"
    for _ in range(60):
        target = tmp_path / "damaged" / name
        shutil.rmtree(target.parent, ignore_errors=True)
        target.parent.mkdir()
        (shutil.copytree if stranger.is_dir() else shutil.copy)(stranger, target)
        file = draw.choice(sorted(target.iterdir())) if target.is_dir() else target
        content = bytearray(file.read_bytes())
        for _ in range(draw.choice([1, 1, 10])):
            content[draw.randrange(min(len(content), 6000)) * draw.choice([1, -1])] = draw.choice([0, 255, 7, 61])
        file.write_bytes(content)
        with suppress(InputError):
            read_drive(target, {})


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the limit to memory is Linux's")
@pytest.mark.slow
def test_a_file_that_means_gigabytes_is_refused(tmp_path, messages, monkeypatch):
    """Few bytes of bz2 that unpack to 300 MB, where 100 MB are allowed."""
    import resource

    from rosbags import rosbag1

    monkeypatch.setattr(reading, "MEMORY", 100 * 2**20)
    limits = resource.getrlimit(resource.RLIMIT_AS), resource.getrlimit(resource.RLIMIT_FSIZE)
    new, path = messages(first=True), tmp_path / "drive.bag"
    bag = rosbag1.Writer(path)
    bag.compression_format, zeros = "bz2", bz2.compress(bytes(10 * 2**20))
    bag.compressor = lambda chunk: bz2.compress(chunk) + 30 * zeros
    with bag:
        connection = bag.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=new.store)
        bag.write(connection, 10**9, new.store.serialize_ros1(new.odometry(1.0), "nav_msgs/msg/Odometry"))
    assert path.stat().st_size < 50_000
    refused(path, "takes more than 0.1 GB of memory")
    assert (resource.getrlimit(resource.RLIMIT_AS), resource.getrlimit(resource.RLIMIT_FSIZE)) == limits
