"""A ROS node that records what it receives and the commands that it sends."""

import threading
from collections.abc import Callable
from typing import Any

from tb2rl.deploy.bags.writing import BagWriter
from tb2rl.deploy.ros.events import BumperEvent, Flag
from tb2rl.deploy.ros.messages import BILLION, LaserScan, Message, Odometry, Twist
from tb2rl.deploy.ros.node import Endpoint, M, Node

_RECORDED = LaserScan, Odometry, BumperEvent, Flag, Twist
_DEPTH = 100  # messages that can wait, so that none is lost


class RecordedNode:
    """A `Node` that writes scans, odometry, bumper events and velocity commands to a bag, and is otherwise that node.

    The time of a message in the bag is the ROS time at which it arrived or was sent; its header has its own stamp.
    Without a `writer` nothing is recorded.
    """

    def __init__(self, node: Node, writer: BagWriter | None) -> None:
        self._node, self._writer, self._uses_sim_time = node, writer, node.uses_sim_time()
        self._lock, self._last_time = threading.Lock(), 0  # [ns]
        self.count = 0  # recorded messages
        self.error: Exception | None = None  # why the bag could not be written

    def __getattr__(self, name: str) -> Any:
        return getattr(self._node, name)

    def create_publisher(self, topic: str, message_type: type[Message]) -> Endpoint:
        """Create a publisher, see `Node`."""
        endpoint = self._node.create_publisher(topic, message_type)

        def send(message: Message) -> None:
            self._record(topic, message)
            endpoint.publish(message)

        return Endpoint(lambda: int(endpoint.connected()), send)

    def create_subscription(self, topic: str, message_type: type[M], callback: Callable[[M], None]) -> Endpoint:
        """Call a function with each message, see `Node`."""

        def receive(message: M) -> None:
            self._record(topic, message)
            callback(message)

        return self._node.create_subscription(topic, message_type, receive, _DEPTH)

    def close(self) -> None:
        """End the recording, and leave ROS."""
        with self._lock:
            self._writer = None  # because threads of ROS may still have messages
        self._node.close()

    def _record(self, topic: str, message: Message) -> None:
        with self._lock:
            if self._writer is None or not isinstance(message, _RECORDED):
                return
            try:
                self._writer.write(topic, message, self._time(message))
                self.count += 1
            except Exception as error:  # in a thread of ROS, which would hide it
                self.error = self.error or error

    def _time(self, message: Message) -> int:
        """The ROS time [ns]; simulated time may arrive after the messages of that time."""
        now = round(self._node.now() * BILLION)
        if self._uses_sim_time:
            now = self._last_time = max(now, self._last_time, getattr(message, "stamp", 0))
        return now
