"""Messages of bags, made and serialized by the library `rosbags`."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, install_extra
from tb2rl.deploy.ros.messages import BILLION

BUMPER_EVENTS = {1: "kobuki_msgs/msg/BumperEvent", 2: "kobuki_ros_interfaces/msg/BumperEvent"}  # by version of ROS
_DEFINITIONS = {  # of messages that the library lacks
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    **dict.fromkeys(BUMPER_EVENTS.values(), "uint8 bumper\nuint8 state"),
}


class BagMessages:
    """Makes messages of ROS 1 or ROS 2, see `tb2rl.deploy.ros.protocols.MessageFactory`, and serializes them.

    Attributes:
        store: The library's message types.
        seq: Number in the header of messages of ROS 1.
    """

    def __init__(self, ros: int) -> None:
        self.ros, self.store, self.seq = ros, message_types(ros), 0

    def name(self, kind: str) -> str:
        """Return the library's name of a kind of message."""
        name = kind.replace("/msg/", "/").replace("/", "/msg/")
        return BUMPER_EVENTS[self.ros] if name in BUMPER_EVENTS.values() else name

    def new(self, kind: str) -> Any:
        name = self.name(kind)
        _, fields = self.store.fielddefs[name]
        values = {field: self._default(form.name, detail) for field, (form, detail) in fields}
        if "seq" in values:
            values["seq"] = self.seq
        return self.store.types[name](**values)

    def _default(self, form: str, detail: Any) -> Any:
        if form == "NAME":
            return self.new(detail)
        if form == "BASE":
            return {"string": "", "bool": False}.get(detail[0], 0)
        (element, number), length = detail
        return np.zeros(length, dtype=number[0]) if element.name == "BASE" else []

    def time(self, nanoseconds: int) -> Any:
        seconds, rest = divmod(nanoseconds, BILLION)
        return self.store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)

    def uint8_array(self, data: bytes) -> np.ndarray:
        return np.frombuffer(data, np.uint8)

    def float32_array(self, values: np.ndarray) -> np.ndarray:
        return values.astype(np.float32)

    def serialize(self, message: Any) -> bytes:
        serialize = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        return serialize(message, message.__msgtype__)

    def deserialize(self, raw: bytes, name: str) -> Any:
        return (self.store.deserialize_ros1 if self.ros == 1 else self.store.deserialize_cdr)(raw, name)


@cache
def message_types(ros: int) -> Any:
    """Return the library's message types for a version of ROS."""
    typesys = rosbags_library().typesys
    store = typesys.get_typestore(typesys.Stores["ROS1_NOETIC" if ros == 1 else "ROS2_HUMBLE"])
    for name, definition in _DEFINITIONS.items():
        if name not in store.fielddefs:
            store.register(typesys.get_types_from_msg(definition, name))
    return store


def rosbags_library() -> Any:
    """Return the library, with the parts that are used here.

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
