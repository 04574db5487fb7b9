"""Kinds of topics in a bag: how to find a topic of each kind, and how to convert its messages."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.deploy.bags.messages import BUMPER_EVENTS
from tb2rl.deploy.ros.messages import Goal, Odometry
from tb2rl.deploy.ros.topics import split_pairs

MAX_VALUE = 1e9  # [m], [m/s], [s] ...; larger values are errors
Row = tuple[float, ...]


def _motion(message: Any) -> Row:
    odometry = Odometry.from_ros(message)
    return *odometry.pose, *odometry.twist


def _min_range(message: Any) -> Row:
    ranges = message.ranges
    valid = ranges[(ranges >= message.range_min) & (ranges <= min(message.range_max, MAX_VALUE))]
    return (float(valid.min(initial=math.inf)),)


def _command(message: Any) -> Row:
    twist = getattr(message, "twist", message)
    return twist.linear.x, twist.angular.z


def _bumper_state(message: Any) -> Row:
    return (float(message.data if hasattr(message, "data") else message.state),)


@dataclass(frozen=True)
class TopicKind:
    """A kind of topic, whose messages become a table of a drive."""

    types: tuple[str, ...]  # message types
    names: tuple[str, ...]  # common topic names, the most likely first
    value_count: int  # number of values from a message
    convert: Callable[[Any], Row]  # returns the values from a message
    any_name: bool = False  # whether to use a topic with another name, if its type matches


_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_ODOMETRY, _SCAN, _GOAL = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "geometry_msgs/msg/PoseStamped"
_PRESSED = ("std_msgs/msg/Bool", *BUMPER_EVENTS.values())
_TRUTH_TOPICS = ("/ground_truth", "/ground_truth/state", "/base_pose_ground_truth")
_COMMAND_TOPICS = ("/cmd_vel", "/mobile_base/commands/velocity", "/commands/velocity")
_BUMPER_TOPICS = ("/bumper", "/mobile_base/events/bumper", "/events/bumper")
_GOAL_TOPICS = ("/move_base_simple/goal", "/goal_pose")
TOPIC_KINDS: Mapping[str, TopicKind] = {  # in the order of the tables of a `Drive`
    "odom": TopicKind((_ODOMETRY,), ("/odom", "/odometry/filtered"), 5, _motion, any_name=True),
    "ground_truth": TopicKind((_ODOMETRY,), _TRUTH_TOPICS, 5, _motion),
    "scan": TopicKind((_SCAN,), ("/kobuki/laser/scan", "/scan"), 1, _min_range, any_name=True),
    "cmd_vel": TopicKind(_TWISTS, _COMMAND_TOPICS, 2, _command, any_name=True),
    "bumper": TopicKind(_PRESSED, _BUMPER_TOPICS, 1, _bumper_state),
    "goal": TopicKind((_GOAL,), _GOAL_TOPICS, 2, lambda message: Goal.from_ros(message).position),
}


def parse_topics(pairs: Iterable[str]) -> dict[str, str]:
    """Parse topics by kind, such as "odom=/odometry/filtered".

    Raises:
        InputError: If a pair has no "=", or its kind is unknown.
    """
    topics = split_pairs(pairs, "KIND=NAME, such as odom=/odometry/filtered")
    for kind in topics.keys() - TOPIC_KINDS.keys():
        raise unknown("kind of topic", kind, TOPIC_KINDS)
    return topics


def find_topics(available: Mapping[str, tuple[str, int]], chosen: Mapping[str, str]) -> dict[str, str]:
    """Find the topic of each kind; the result lacks kinds for which there is no topic.

    Args:
        available: Type and number of messages of each topic in the bag.
        chosen: Topics that the user chose, by kind.

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
