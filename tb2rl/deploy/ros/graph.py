"""What a program asks of ROS: to publish, to listen and to serve. `ros1` and `ros2` answer it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, Protocol, TypeVar

from tb2rl.deploy.ros.messages import Heard, Message

EMPTY, TRIGGER, SET_PHYSICS = "std_srvs/Empty", "std_srvs/Trigger", "gazebo_msgs/SetPhysicsProperties"  # of services
H = TypeVar("H", bound=Heard)


class End(Protocol):
    """Our end of a topic."""

    def connected(self) -> bool:
        """Whether anybody is at the other end."""


class Publisher(End, Protocol):
    """The end that talks."""

    def say(self, message: Message) -> None:
        """Publish it, if anybody listens."""


class Nobody:
    """The end of a topic that has no other: ROS has no messages of its kind."""

    def connected(self) -> bool:
        return False

    def say(self, message: Message) -> None:
        pass


class Graph(Protocol):
    """A node of ours among those of ROS; it is part of the graph from the moment it is made."""

    def publisher(self, topic: str, kind: type[Message]) -> Publisher:
        """The end of a topic that talks; a `Nobody` where messages of a rare kind are not installed.

        Raises:
            InputError: If those of a usual kind are not.
        """

    def listen(self, topic: str, kind: type[H], heard: Callable[[H], None]) -> End:
        """Have a function called with each message on a topic, in a thread of ROS; see `publisher`."""

    def serve(self, service: str, kind: str, called: Callable[[], str | None]) -> None:
        """Offer a service that calls a function, in a thread of ROS, and then answers; not where ROS lacks its kind.

        Args:
            service: Its name; "~/NAME" is below that of our node.
            kind: Of the service.
            called: Returns why it failed; nothing: it did not.
        """

    def call(self, service: str, kind: str) -> bool:
        """Call a service, and wait for its answer; False: nobody offers it.

        Raises:
            InputError: If it fails.
        """

    def now(self) -> float:
        """What time it is in the graph [s]: simulated where the graph says so."""

    def time_is_simulated(self) -> bool:
        """Whether `/clock` says what time it is."""

    def keep_time(self) -> None:
        """Tell all programs that the time is what `/clock` says, where ROS has a word for that."""

    def is_over(self) -> bool:
        """Whether ROS has ended our node."""

    def close(self) -> None:
        """Leave the graph."""


def join(version: int, name: str, arguments: Sequence[str] = ()) -> Graph:
    """A node with this name in the graph of ROS 1 or ROS 2, as the environment says; only that ROS is imported.

    Args:
        version: Of ROS.
        name: Of the node.
        arguments: What follows `--ros-args` on a command line; for ROS 2.

    Raises:
        InputError: If this ROS is not installed, its master does not answer, or it does not know the arguments.
    """
    if version == 1:
        from tb2rl.deploy.ros.ros1 import Graph1

        return Graph1(name)
    from tb2rl.deploy.ros.ros2 import Graph2

    return Graph2(name, arguments)


def find_kind(package: str, part: str, name: str) -> Any:
    """The class of a message (part "msg") or a service ("srv"); None where its package is not installed."""
    try:
        return getattr(import_module(f"{package}.{part}"), name)
    except ImportError:
        return None
