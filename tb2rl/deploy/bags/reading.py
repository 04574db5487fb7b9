"""Reads drives from bags of any robot: ROS 1 files, ROS 2 folders, mcap and db3 files.

A bag contains definitions of its message types, from which `rosbags` could generate code. For safety it must not: the
definitions are only compared with those of ROS. `read_drive` catches all exceptions, because `rosbags` documents none.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.values import Pose
from tb2rl.deploy.bags.messages import BUMPER_EVENTS, BagMessages, rosbags_library
from tb2rl.deploy.bags.scans import Scans, ScanTable, message_age
from tb2rl.deploy.ros.messages import Goal, Odometry
from tb2rl.deploy.ros.topics import split_pairs

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
MAX_MESSAGES = 2_000_000  # eleven hours at 50 Hz
MAX_VALUE = 1e9  # [m], [m/s], [s] ...; messages with larger values are left out
Row = tuple[float, ...]


@dataclass(frozen=True)
class Drive:
    """A recorded drive. Each table has a row per message, or no rows if the bag lacks such messages.

    The first column of each table is the time since the first message [s].
    """

    name: str  # of the bag
    topics: Mapping[str, str]  # of the tables, by the kinds of `TOPIC_KINDS`
    # Time, x [m], y [m], yaw [rad], forward speed [m/s], turn rate [rad/s], and age of the message when it arrived [s],
    # shape (messages, 7):
    odometry: np.ndarray
    truth: np.ndarray  # true motion in the world's frame, from a simulation, with the columns of `odometry`
    scan_minima: np.ndarray  # time, shortest range of a scan [m], inf without an obstacle in range, shape (messages, 2)
    commands: np.ndarray  # time, v [m/s], w [rad/s], shape (messages, 3)
    bumper: np.ndarray  # time, 1 if the bumper is pressed, else 0, shape (messages, 2)
    goals: np.ndarray  # time, x [m], y [m], shape (messages, 3)
    scans: Scans | None = field(default=None, kw_only=True)  # the full scans, if they were asked for and there are any

    @property
    def trajectory(self) -> np.ndarray:
        """The true motion if the bag has it, else the odometry."""
        return self.truth if len(self.truth) else self.odometry

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float(self.trajectory[-1, 0] - self.trajectory[0, 0])

    @property
    def distance(self) -> float:
        """Length of the path [m]."""
        return float(np.hypot(*np.diff(self.trajectory[:, 1:3], axis=0).T).sum())

    @property
    def speed(self) -> float:
        """Mean speed [m/s]; 0 if the duration is 0."""
        return self.distance / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def min_range(self) -> float:
        """Shortest range of all scans [m]; inf without scans."""
        return float(self.scan_minima[:, 1].min(initial=math.inf))

    @property
    def contacts(self) -> int | None:
        """Number of contacts; None if the bag has no bumper messages."""
        return int((np.diff(self.bumper[:, 1], prepend=0.0) > 0.0).sum()) if len(self.bumper) else None

    def path_from(self, pose: Pose) -> np.ndarray:
        """Return the path x, y [m], shape (messages, 2), shifted and rotated so that it begins at a pose."""
        return moved(self.trajectory[:, 1:4], np.array(pose))[:, :2]


def moved(paths: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Move paths of poses x, y, yaw, shape (..., poses, 3), so that they begin at other poses, shape (..., 3)."""
    turn = (starts[..., 2] - paths[..., 0, 2])[..., None]
    x, y = np.moveaxis(paths[..., :2] - paths[..., :1, :2], -1, 0)
    cos, sin = np.cos(turn), np.sin(turn)
    columns = cos * x - sin * y + starts[..., :1], sin * x + cos * y + starts[..., 1:2], paths[..., 2] + turn
    return np.stack(columns, axis=-1)


def is_bag(path: Path) -> bool:
    """Whether a path looks like the path of a bag."""
    return path.suffix in BAG_SUFFIXES or (path / "metadata.yaml").is_file()


def read_drive(path: Path, topics: Mapping[str, str], scans: bool = False) -> Drive:
    """Read the drive in a bag.

    Args:
        path: The bag.
        topics: Topics that the user chose, by kind; the others are found by their names and types, see `find_topics`.
        scans: Whether to read the full scans, which take memory.

    Raises:
        InputError: If `rosbags` is not installed, or the bag cannot be read, is too large or has no odometry.
    """
    rosbags_library()
    if not path.exists():
        raise InputError(one_line(f"there is no bag {path}"))
    try:
        return _read(path, topics, scans)
    except InputError as error:
        raise InputError(one_line(f"{path}: {error}")) from None
    except Exception as error:
        raise InputError(one_line(f"cannot read the bag {path}: {error!r}")) from None


def _read(path: Path, topics: Mapping[str, str], scans: bool) -> Drive:
    library, messages = rosbags_library(), BagMessages(1 if path.suffix == ".bag" else 2)
    with (library.rosbag1 if messages.ros == 1 else library.rosbag2).Reader(path) as bag:
        available = {name: (topic.msgtype or "several types", topic.msgcount) for name, topic in bag.topics.items()}
        found = find_topics(available, topics)
        if not {"odom", "ground_truth"} & set(found):
            name_list = ", ".join(f"{topic} ({message_type})" for topic, (message_type, _) in sorted(available.items()))
            raise InputError(f"the bag has no odometry; its topics: {name_list or 'none'}")
        connections = [connection for connection in bag.connections if connection.topic in found.values()]
        for connection in connections:
            _check_definition(messages.store, connection)
        values: dict[str, array[float]] = {kind: array("d") for kind in TOPIC_KINDS}
        start, scan_table = None, ScanTable()  # [ns] of the first message
        for count, (connection, stamp, raw) in enumerate(bag.messages(connections)):
            if count == MAX_MESSAGES:
                name_list = ", ".join(dict.fromkeys(found.values()))
                raise InputError(f"the bag has more than {MAX_MESSAGES} messages on {name_list}: cut it first")
            start = stamp if start is None else start
            message = messages.deserialize(raw, connection.msgtype)
            for kind in found:
                if found[kind] == connection.topic:
                    values[kind].extend(((stamp - start) / 1e9, *TOPIC_KINDS[kind].convert(message, stamp)))
                    if kind == "scan" and scans:
                        scan_table.add(message, (stamp - start) / 1e9, message_age(message, stamp))
    tables = {kind: _make_table(kind, values[kind]) for kind in TOPIC_KINDS}
    if not len(tables["odom"]) + len(tables["ground_truth"]):
        raise InputError("the odometry has no valid pose")
    return Drive(path.name, found, *tables.values(), scans=scan_table.scans())


def _check_definition(store: Any, connection: Any) -> None:
    """Raise an `InputError` if the bag defines a message type differently from ROS."""
    definition = connection.msgdef
    if definition.format.name != "MSG":  # there is no definition, or one in another language
        return
    parsed = rosbags_library().typesys.get_types_from_msg(definition.data, connection.msgtype)
    if any(store.fielddefs.get(name, ((), ()))[1] != fields for name, (_, fields) in parsed.items()):
        raise InputError(f"{connection.msgtype} on {connection.topic} is defined differently from ROS")


def _make_table(kind: str, values: array[float]) -> np.ndarray:
    """Make a table in the order of time, without rows that have NaN, infinite or implausible values."""
    table = np.array(values).reshape(-1, 1 + TOPIC_KINDS[kind].value_count)
    table = table[np.argsort(table[:, 0], kind="stable")]
    checked_columns = table[:, :1] if kind == "scan" else table  # a shortest range may be inf
    return table[(np.abs(checked_columns) < MAX_VALUE).all(axis=1)]


# ---- kinds of topics: how to find a topic of each kind, and how to convert its messages


def _motion(message: Any, log_time: int) -> Row:
    odometry = Odometry.from_ros(message)
    return *odometry.pose, *odometry.twist, message_age(message, log_time)


def _min_range(message: Any, _: int) -> Row:
    ranges = message.ranges
    valid = ranges[(ranges >= message.range_min) & (ranges <= min(message.range_max, MAX_VALUE))]
    return (float(valid.min(initial=math.inf)),)


def _command(message: Any, _: int) -> Row:
    twist = getattr(message, "twist", message)
    return twist.linear.x, twist.angular.z


def _bumper_state(message: Any, _: int) -> Row:
    return (float(message.data if hasattr(message, "data") else message.state),)


@dataclass(frozen=True)
class TopicKind:
    """A kind of topic, whose messages become a table of a drive."""

    types: tuple[str, ...]  # message types
    names: tuple[str, ...]  # common topic names, the most likely first
    value_count: int  # number of values from a message
    convert: Callable[[Any, int], Row]  # returns the values from a message and its time in the bag [ns]
    any_name: bool = False  # whether to use a topic with another name, if its type matches


_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_ODOMETRY, _SCAN, _GOAL = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "geometry_msgs/msg/PoseStamped"
_BUMPER = ("std_msgs/msg/Bool", *BUMPER_EVENTS.values())
_TRUTH_TOPICS = ("/ground_truth", "/ground_truth/state", "/base_pose_ground_truth")
_COMMAND_TOPICS = ("/cmd_vel", "/mobile_base/commands/velocity", "/commands/velocity")
_BUMPER_TOPICS = ("/bumper", "/mobile_base/events/bumper", "/events/bumper")
_GOAL_TOPICS = ("/move_base_simple/goal", "/goal_pose")
TOPIC_KINDS: Mapping[str, TopicKind] = {  # in the order of the tables of a `Drive`
    "odom": TopicKind((_ODOMETRY,), ("/odom", "/odometry/filtered"), 6, _motion, any_name=True),
    "ground_truth": TopicKind((_ODOMETRY,), _TRUTH_TOPICS, 6, _motion),
    "scan": TopicKind((_SCAN,), ("/kobuki/laser/scan", "/scan"), 1, _min_range, any_name=True),
    "cmd_vel": TopicKind(_TWISTS, _COMMAND_TOPICS, 2, _command, any_name=True),
    "bumper": TopicKind(_BUMPER, _BUMPER_TOPICS, 1, _bumper_state),
    "goal": TopicKind((_GOAL,), _GOAL_TOPICS, 2, lambda message, _: Goal.from_ros(message).position),
}


def parse_topics(pairs: Iterable[str]) -> dict[str, str]:
    """Parse "odom=/odometry/filtered" and so on; raises an `InputError` for a pair without "=", or an unknown kind."""
    topics = split_pairs(pairs, "KIND=NAME, such as odom=/odometry/filtered")
    for kind in topics.keys() - TOPIC_KINDS.keys():
        raise unknown("kind of topic", kind, TOPIC_KINDS)
    return topics


def find_topics(available: Mapping[str, tuple[str, int]], chosen: Mapping[str, str]) -> dict[str, str]:
    """Find the topic of each kind; the result lacks kinds for which there is no topic.

    `available` are type and number of messages of each topic in the bag, `chosen` the user's topics, by kind.

    Raises:
        InputError: If a chosen topic is not in the bag, or has another type.
    """
    found = {}
    for kind, spec in TOPIC_KINDS.items():
        counts = {topic: count for topic, (message_type, count) in available.items() if message_type in spec.types}
        if kind in chosen and chosen[kind] not in counts:
            types, possible = " or ".join(spec.types), one_line(", ".join(sorted(counts)) or "no topic")
            raise InputError(f"the bag has no topic {chosen[kind]} of type {types}; {kind} can be: {possible}")
        nonempty = sorted((topic for topic, count in counts.items() if count), key=lambda topic: -counts[topic])
        by_name = [topic for name in spec.names for topic in nonempty if f"/{topic.lstrip('/')}" == name]
        candidates = [*([chosen[kind]] if kind in chosen else by_name), *(nonempty if spec.any_name else ())]
        if candidates:
            found[kind] = candidates[0]
    return found
