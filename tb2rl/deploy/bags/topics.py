"""What a drive is made of, the topics of a bag that hold it, and the library that knows their messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from tb2rl.core.errors import InputError, install_extra, one_line, unknown


@dataclass(frozen=True)
class Kind:
    """A part of a drive.

    Attributes:
        types: Of the messages that can hold it.
        names: Topics that are known to hold it, the likeliest first.
        guessed: Whether any other topic of such a type will do.
    """

    types: tuple[str, ...]
    names: tuple[str, ...]
    guessed: bool = True


BUMPER_EVENTS = {1: "kobuki_msgs/msg/BumperEvent", 2: "kobuki_ros_interfaces/msg/BumperEvent"}  # of ROS 1 and 2
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


TRANSFORMS = "tf2_msgs/msg/TFMessage"


def parse_topics(pairs: Iterable[str]) -> dict[str, str]:
    """The topics that a user names, by kind, from texts such as "odom=/odometry/filtered".

    Raises:
        InputError: If one is not of that form, or there is no such kind.
    """
    topics = {}
    for pair in pairs:
        kind, equals, topic = pair.partition("=")
        if not (equals and topic):
            raise InputError(one_line(f"--topics takes KIND=NAME, such as odom=/odometry/filtered, got {pair!r}"))
        if kind not in KINDS:
            raise unknown("kind of topic", kind, KINDS)
        topics[kind] = topic
    return topics


def find_topics(there: Mapping[str, tuple[str, int]], named: Mapping[str, str]) -> dict[str, str]:
    """Which topic of a bag holds each kind; kinds that none holds are left out.

    Args:
        there: Type and number of messages of each topic.
        named: Topics by kind that the user chose.

    Raises:
        InputError: If a topic that the user chose is not there, or its messages are not of that kind.
    """
    for kind, topic in named.items():
        fitting = [name for name, (held, _) in there.items() if held in KINDS[kind].types]
        if topic not in fitting:
            raise InputError(
                f"it has no topic {topic} of type {' or '.join(KINDS[kind].types)}; {kind} can be: {_listed(fitting)}"
            )
    found = {kind: _likeliest(KINDS[kind], there) for kind in KINDS}
    return {kind: topic for kind, topic in {**found, **named}.items() if topic is not None}


def _likeliest(kind: Kind, there: Mapping[str, tuple[str, int]]) -> str | None:
    """A topic that is known to hold a kind, else the one of its type that says the most."""
    fitting = {name: count for name, (held, count) in there.items() if held in kind.types and count}
    known = [name for likely in kind.names for name in fitting if f"/{name.lstrip('/')}" == likely]
    if known or not kind.guessed:
        return known[0] if known else None
    return max(fitting, key=lambda name: fitting[name], default=None)


def _listed(names: list[str]) -> str:
    return one_line(", ".join(sorted(names)) or "no topic")


@cache
def message_types(library: Any, first: bool) -> Any:
    """The messages of ROS 1 or, if it is not the first, of ROS 2, as the library keeps them."""
    store = library.typesys.get_typestore(library.typesys.Stores["ROS1_NOETIC" if first else "ROS2_HUMBLE"])
    if TRANSFORMS not in store.fielddefs:  # the library knows the one of ROS 2 alone
        definition = "geometry_msgs/TransformStamped[] transforms"
        store.register(library.typesys.get_types_from_msg(definition, TRANSFORMS))
    event = BUMPER_EVENTS[1 if first else 2]
    if event not in store.fielddefs:
        store.register(library.typesys.get_types_from_msg("uint8 bumper\nuint8 state", event))
    return store


def rosbags_library() -> Any:
    """The library, with the parts that are used here.

    Raises:
        InputError: If it is not installed.
    """
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2
        import rosbags.typesys
    except ImportError:
        raise InputError(f"bags take the extra `bags`: {install_extra('bags')}") from None
    return rosbags
