"""A node of ROS: publishers, subscriptions, services and time. `ros1` and `ros2` implement it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, TypeVar

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.deploy.ros.messages import OPTIONAL
from tb2rl.deploy.ros.protocols import IncomingMessage, MessageFactory, OutgoingMessage

EMPTY, TRIGGER, SET_PHYSICS = "std_srvs/Empty", "std_srvs/Trigger", "gazebo_msgs/SetPhysicsProperties"  # services
QUEUE = 10  # messages that wait for a slow subscriber
M = TypeVar("M", bound=IncomingMessage)


@dataclass(frozen=True)
class Endpoint:
    """Our end of a topic; `count_peers` counts the nodes at the other end."""

    count_peers: Callable[[], int]

    def connected(self) -> bool:
        """Whether another node is connected."""
        return self.count_peers() > 0


@dataclass(frozen=True)
class Publisher(Endpoint):
    """Publishes messages, if a node subscribes to them."""

    send: Callable[[Any], None]
    messages: MessageFactory

    def publish(self, message: OutgoingMessage) -> None:
        if self.connected():
            self.send(message.to_ros(self.messages))


@dataclass(frozen=True)
class NullPublisher(Endpoint):
    """Stands for a topic whose message type is not installed."""

    count_peers: Callable[[], int] = lambda: 0

    def publish(self, message: OutgoingMessage) -> None:
        pass


class Node(ABC):
    """A node that has joined ROS; it makes the messages of its ROS, see `MessageFactory`."""

    version: ClassVar[int]
    install: ClassVar[str]  # how to install missing messages

    def new(self, kind: str) -> Any:
        return self.get_type(kind)()

    @abstractmethod
    def time(self, nanoseconds: int) -> Any: ...

    @abstractmethod
    def uint8_array(self, data: bytes) -> Any: ...

    def float32_array(self, values: np.ndarray) -> Any:
        return array("f", values.astype(np.float32).tobytes())

    def find_type(self, kind: str, part: str = "msg") -> Any:
        """Return the class of a message (part "msg") or a service ("srv"); None if its package is not installed."""
        package, name = kind.split("/")
        try:
            return getattr(import_module(f"{package}.{part}"), name)
        except ImportError:
            return None

    def get_type(self, kind: str, part: str = "msg") -> Any:
        """Return the class of a message or a service.

        Raises:
            InputError: If its package is not installed.
        """
        found = self.find_type(kind, part)
        if found is None:
            raise InputError(f"there is no {kind} for ROS {self.version}; {self.install}")
        return found

    def create_publisher(self, topic: str, message_type: type[OutgoingMessage]) -> Publisher | NullPublisher:
        """Create a publisher; a `NullPublisher` if the messages are optional and not installed.

        Raises:
            InputError: If other messages are not installed.
        """
        if message_type in OPTIONAL and self.find_type(message_type.kind) is None:
            return NullPublisher()
        return self._create_publisher(topic, message_type)

    def create_subscription(self, topic: str, message_type: type[M], callback: Callable[[M], None]) -> Endpoint:
        """Call a function with each message, in a thread of ROS; for missing messages see `create_publisher`."""
        if message_type in OPTIONAL and self.find_type(message_type.kind) is None:
            return NullPublisher()
        return self._create_subscription(topic, message_type, callback)

    @abstractmethod
    def _create_publisher(self, topic: str, message_type: type[OutgoingMessage]) -> Publisher: ...

    @abstractmethod
    def _create_subscription(self, topic: str, message_type: type[M], callback: Callable[[M], None]) -> Endpoint: ...

    @abstractmethod
    def create_service(self, service: str, kind: str, callback: Callable[[], str | None]) -> None:
        """Offer a service; "~/NAME" is below the name of the node. A kind that this ROS lacks is skipped.

        `callback` runs in a thread of ROS and returns the reason of a failure; None or "": success.
        """

    @abstractmethod
    def call(self, service: str, kind: str) -> bool:
        """Call a service and wait for its answer; False: no node offers it.

        Raises:
            InputError: If it fails.
        """

    @abstractmethod
    def now(self) -> float:
        """Return the ROS time [s]; simulated if ROS uses `/clock`."""

    @abstractmethod
    def uses_sim_time(self) -> bool:
        """Whether `/clock` determines the time."""

    @abstractmethod
    def announce_sim_time(self) -> None:
        """Make all programs use `/clock`, if this ROS has a common setting for it."""

    @abstractmethod
    def is_shutdown(self) -> bool:
        """Whether ROS has ended the node."""

    @abstractmethod
    def close(self) -> None:
        """Leave ROS."""
