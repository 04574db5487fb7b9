"""Parts of a drive: the topics that hold them, and the values of their messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.deploy.bags.messages import BUMPER_EVENTS

FARTHEST = 1e9  # [m], [s] larger values are errors
Row = tuple[float, ...]


def _motion(message: Any) -> Row:
    position, rotation, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    sin = 2.0 * (rotation.w * rotation.z + rotation.x * rotation.y)
    cos = 1.0 - 2.0 * (rotation.y * rotation.y + rotation.z * rotation.z)
    return position.x, position.y, math.atan2(sin, cos), twist.linear.x, twist.angular.z


def _nearest(message: Any) -> Row:
    ranges = message.ranges
    valid = ranges[(ranges >= message.range_min) & (ranges <= min(message.range_max, FARTHEST))]
    return (float(valid.min(initial=math.inf)),)


def _command(message: Any) -> Row:
    twist = getattr(message, "twist", message)
    return twist.linear.x, twist.angular.z


def _pressed(message: Any) -> Row:
    return (float(message.data if hasattr(message, "data") else message.state),)


def _goal(message: Any) -> Row:
    return message.pose.position.x, message.pose.position.y


@dataclass(frozen=True)
class Kind:
    """A part of a drive.

    Attributes:
        types: Types of messages that can hold it.
        names: Usual topics, the most likely first.
        columns: Number of values in a message.
        convert: Returns the values of a message.
        guessed: Whether any other topic of such a type is used, too.
    """

    types: tuple[str, ...]
    names: tuple[str, ...]
    columns: int
    convert: Callable[[Any], Row]
    guessed: bool = False


_ODOMETRY, _SCAN, _GOAL = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "geometry_msgs/msg/PoseStamped"
_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_PRESSED = ("std_msgs/msg/Bool", *BUMPER_EVENTS.values())
_TRUTH = ("/ground_truth", "/ground_truth/state", "/base_pose_ground_truth")
_COMMANDS = ("/cmd_vel", "/mobile_base/commands/velocity", "/commands/velocity")
_BUMPERS = ("/bumper", "/mobile_base/events/bumper", "/events/bumper")
KINDS: Mapping[str, Kind] = {
    "odom": Kind((_ODOMETRY,), ("/odom", "/odometry/filtered"), 5, _motion, guessed=True),
    "ground_truth": Kind((_ODOMETRY,), _TRUTH, 5, _motion),
    "scan": Kind((_SCAN,), ("/kobuki/laser/scan", "/scan"), 1, _nearest, guessed=True),
    "cmd_vel": Kind(_TWISTS, _COMMANDS, 2, _command, guessed=True),
    "bumper": Kind(_PRESSED, _BUMPERS, 1, _pressed),
    "goal": Kind((_GOAL,), ("/move_base_simple/goal", "/goal_pose"), 2, _goal),
}


def parse_topics(pairs: Iterable[str]) -> dict[str, str]:
    """Parse topics by kind, such as "odom=/odometry/filtered".

    Raises:
        InputError: For another form or an unknown kind.
    """
    topics = {}
    for pair in pairs:
        kind, _, topic = pair.partition("=")
        if not topic:
            raise InputError(one_line(f"--topics takes KIND=NAME, such as odom=/odometry/filtered, got {pair!r}"))
        if kind not in KINDS:
            raise unknown("kind of topic", kind, KINDS)
        topics[kind] = topic
    return topics


def find_topics(available: Mapping[str, tuple[str, int]], chosen: Mapping[str, str]) -> dict[str, str]:
    """Find the topic of each kind; a kind without a topic is left out.

    Args:
        available: Type and number of messages of each topic in the bag.
        chosen: Topics by kind that the user chose.

    Raises:
        InputError: If the bag has no such topic, or its messages have another type.
    """
    for kind, topic in chosen.items():
        fitting = sorted(name for name, (held, _) in available.items() if held in KINDS[kind].types)
        if topic not in fitting:
            listed = one_line(", ".join(fitting) or "no topic")
            types = " or ".join(KINDS[kind].types)
            raise InputError(f"it has no topic {topic} of type {types}; {kind} can be: {listed}")
    found = {kind: _likeliest(KINDS[kind], available) for kind in KINDS}
    return {kind: topic for kind, topic in {**found, **chosen}.items() if topic is not None}


def _likeliest(kind: Kind, available: Mapping[str, tuple[str, int]]) -> str | None:
    """Return a topic with a usual name, or else the one of a fitting type with the most messages."""
    fitting = {name: count for name, (held, count) in available.items() if held in kind.types and count}
    usual = [name for likely in kind.names for name in fitting if f"/{name.lstrip('/')}" == likely]
    if usual or not kind.guessed:
        return usual[0] if usual else None
    return max(fitting, key=lambda name: fitting[name], default=None)
