"""The interface of a ROS node: publishers, subscriptions, services and time. `ros1` and `ros2` implement it."""

import threading
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.deploy.ros.messages import Message

EMPTY, TRIGGER, SET_PHYSICS = "std_srvs/Empty", "std_srvs/Trigger", "gazebo_msgs/SetPhysicsProperties"  # service types
QUEUE_SIZE = 10  # messages that wait for a slow subscriber
M = TypeVar("M", bound=Message)


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription of the node; the defaults are for a message type that is not installed."""

    count_peers: Callable[[], int] = lambda: 0  # subscribers of a publisher, publishers of a subscription
    send: Callable[[Message], None] = lambda message: None

    def connected(self) -> bool:
        return self.count_peers() > 0

    def publish(self, message: Message) -> None:
        """Publish a message, if a node subscribes to the topic."""
        if self.connected():
            self.send(message)


ABSENT = Endpoint()  # for message types that are not installed


class Node(Protocol):
    """A node that has joined ROS, and a `MessageFactory`."""

    version: ClassVar[int]
    install_hint: ClassVar[str]  # how to install missing messages

    def make_message(self, type_name: str) -> Any:
        return self.find_type(type_name)()

    def make_time(self, nanoseconds: int) -> Any: ...

    def make_array(self, values: np.ndarray) -> Any:
        return array(values.dtype.char, values.tobytes())

    def find_type(self, type_name: str, module: str = "msg", optional: bool = False) -> Any:
        """Return the class of a message (module "msg") or a service ("srv"); None if optional and not installed.

        Raises:
            InputError: If the type is neither installed nor optional.
        """
        package, name = type_name.split("/")
        try:
            return getattr(import_module(f"{package}.{module}"), name)
        except (ImportError, AttributeError):  # without the package, or in an early version of it
            if optional:
                return None
            raise InputError(f"{type_name} is not installed for ROS {self.version}; {self.install_hint}") from None

    def create_publisher(self, topic: str, message_type: type[Message]) -> Endpoint:
        """Create a publisher; returns `ABSENT` if the message type is optional and not installed."""
        ros_type = self.find_type(message_type.type_name, optional=message_type.optional)
        return self._publisher(topic, message_type, ros_type) if ros_type else ABSENT

    def create_subscription(
        self, topic: str, message_type: type[M], callback: Callable[[M], None], depth: int | None = None
    ) -> Endpoint:
        """Call a function with each message, in a thread of ROS; returns `ABSENT` as `create_publisher` does.

        `depth` is the number of messages that can wait; None: as many as fit the message type.
        """
        ros_type = self.find_type(message_type.type_name, optional=message_type.optional)
        if not ros_type:
            return ABSENT
        latest_only = message_type.latest_only
        return self._subscription(topic, ros_type, latest_only, lambda raw: callback(message_type.from_ros(raw)), depth)

    def _publisher(self, topic: str, message_type: type[Message], ros_type: Any) -> Endpoint: ...

    def _subscription(
        self, topic: str, ros_type: Any, latest_only: bool, receive: Callable[[Any], None], depth: int | None
    ) -> Endpoint:
        """Call `receive` with each message; `latest_only` without `depth`: a new message may replace waiting ones."""

    def create_service(self, service: str, type_name: str, callback: Callable[[], str | None]) -> None:
        """Offer a service; "~/NAME" is private to the node. ROS 2 has no `SET_PHYSICS`; it is not offered there.

        `callback` runs in a thread of ROS. It returns the reason of a failure, else None or an empty string.
        """

    def call(self, service: str, type_name: str) -> bool:
        """Call a service and wait for its answer; returns whether any node offers it. A failure is an `InputError`."""

    def now(self) -> float:
        """Return the ROS time [s], which is simulated time if ROS uses `/clock`."""

    def uses_sim_time(self) -> bool:
        """Whether the ROS time comes from `/clock`."""

    def announce_sim_time(self) -> None:
        """Make all programs use `/clock`, if this version of ROS has a common setting for it."""

    def is_shutdown(self) -> bool:
        """Whether ROS has shut the node down."""

    def close(self) -> None:
        """Leave ROS."""


class WallClock:
    """Wall-clock time; tests replace it by a fake."""

    now = staticmethod(time.monotonic)  # [s]
    sleep = staticmethod(time.sleep)

    def wait(self, condition: threading.Condition | threading.Event, seconds: float) -> bool:
        """Wait for a notification; returns False at a timeout."""
        return condition.wait(seconds)

    def repeat(self, seconds: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call a function periodically in a thread; returns a function that ends the thread."""
        end = threading.Event()

        def run() -> None:
            while not end.wait(seconds):
                callback()

        threading.Thread(target=run, daemon=True).start()
        return end.set
