"""Events of a base: bumpers, cliff sensors, wheels that hang in the air, and buttons, as the Kobuki reports them.

Where the Kobuki's messages are not installed, `std_msgs/Bool` takes their place: true while the event lasts.
"""

from collections.abc import Callable
from typing import Annotated, ClassVar

from tb2rl.deploy.portable.driver import BUMPED, BUTTON, CLIFF, WHEEL_DROP
from tb2rl.deploy.ros.messages import Message
from tb2rl.deploy.ros.node import ABSENT, Node


class Event(Message):
    """Begin or end of an event at one part of the base."""

    optional = True
    why: ClassVar[str]  # reason for a stop of the driver
    part: int
    is_active: Annotated[bool, "state"]


class BumperEvent(Event):
    """Press or release of one of the three bumpers."""

    type_name, why = "kobuki_msgs/BumperEvent", BUMPED
    part: Annotated[int, "bumper"]  # 0 left, 1 in the middle, 2 right


class CliffEvent(Event):
    """A cliff sensor loses or finds the floor."""

    type_name, why = "kobuki_msgs/CliffEvent", CLIFF
    part: Annotated[int, "sensor"]  # 0 left, 1 in the middle, 2 right


class WheelDropEvent(Event):
    """A wheel begins or ceases to hang in the air."""

    type_name, why = "kobuki_msgs/WheelDropEvent", WHEEL_DROP
    part: Annotated[int, "wheel"]  # 0 left, 1 right


class ButtonEvent(Event):
    """Press or release of one of the three buttons."""

    type_name, why = "kobuki_msgs/ButtonEvent", BUTTON
    part: Annotated[int, "button"]


class Flag(Message):
    """The state of an event where the Kobuki's messages are not installed."""

    type_name = "std_msgs/Bool"
    is_active: Annotated[bool, "data"]


# By the keys of their topics:
EVENTS = {"bumper": BumperEvent, "cliff": CliffEvent, "wheel_drop": WheelDropEvent, "button": ButtonEvent}


def subscribe_to_events(node: Node, topics: object, callback: Callable[[Event], None]) -> bool:
    """Call a function with each event; returns whether the Kobuki's messages are installed.

    `topics` has the topics of `EVENTS` as attributes.
    """
    has_messages = True
    for key, event_type in EVENTS.items():
        topic = getattr(topics, key)
        if node.create_subscription(topic, event_type, callback) is ABSENT:
            has_messages = False
            node.create_subscription(topic, Flag, _from_flag(event_type, callback))
    return has_messages


def _from_flag(event_type: type[Event], callback: Callable[[Event], None]) -> Callable[[Flag], None]:
    return lambda flag: callback(event_type(0, flag.is_active))


def create_event_publisher(node: Node, topics: object, key: str) -> Callable[[Event], None]:
    """Create a publisher of events, or of flags where the Kobuki's messages are missing; returns its `publish`."""
    topic = getattr(topics, key)
    publisher = node.create_publisher(topic, EVENTS[key])
    if publisher is not ABSENT:
        return publisher.publish
    flag_publisher = node.create_publisher(topic, Flag)
    return lambda event: flag_publisher.publish(Flag(event.is_active))


def bumper_events(before: int | None, after: int | None) -> list[BumperEvent]:
    """Return the events between two times, given the number of the pressed bumper at each time, or None."""
    if before == after:
        return []
    changes = ((before, False), (after, True))
    return [BumperEvent(bumper, is_active) for bumper, is_active in changes if bumper is not None]
