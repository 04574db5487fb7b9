"""Topics that hold the parts of a drive."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.deploy.bags.messages import BUMPER_EVENTS


@dataclass(frozen=True)
class Kind:
    """A part of a drive.

    Attributes:
        types: Types of messages that can hold it.
        names: Usual topics, the most likely first.
        guessed: Whether any other topic of such a type is used, too.
    """

    types: tuple[str, ...]
    names: tuple[str, ...]
    guessed: bool = True


KINDS: Mapping[str, Kind] = {
    "odom": Kind(("nav_msgs/msg/Odometry",), ("/odom", "/odometry/filtered")),
    "ground_truth": Kind(
        ("nav_msgs/msg/Odometry",), ("/ground_truth", "/ground_truth/state", "/base_pose_ground_truth"), guessed=False
    ),
    "scan": Kind(("sensor_msgs/msg/LaserScan",), ("/kobuki/laser/scan", "/scan")),
    "cmd_vel": Kind(
        ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
        ("/cmd_vel", "/mobile_base/commands/velocity", "/commands/velocity"),
    ),
    "bumper": Kind(
        ("std_msgs/msg/Bool", *BUMPER_EVENTS.values()),
        ("/bumper", "/mobile_base/events/bumper", "/events/bumper"),
        guessed=False,
    ),
    "goal": Kind(("geometry_msgs/msg/PoseStamped",), ("/move_base_simple/goal", "/goal_pose"), guessed=False),
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
