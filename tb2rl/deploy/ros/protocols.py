"""Interfaces between messages as plain values and the messages of ROS."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, Self

import numpy as np


class MessageFactory(Protocol):
    """Makes messages of one version of ROS: `new` an empty one of a kind, the others the values of some fields."""

    def new(self, kind: str) -> Any: ...
    def time(self, nanoseconds: int) -> Any: ...
    def uint8_array(self, data: bytes) -> Any: ...
    def float32_array(self, values: np.ndarray) -> Any: ...


class OutgoingMessage(Protocol):
    """A value that can be published, as a message of a kind such as "sensor_msgs/LaserScan"."""

    kind: ClassVar[str]

    def to_ros(self, ros: MessageFactory) -> Any: ...


class IncomingMessage(Protocol):
    """A value that can be received."""

    kind: ClassVar[str]

    @classmethod
    def from_ros(cls, message: Any) -> Self: ...
