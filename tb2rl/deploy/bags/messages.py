"""Messages in bags; the library `rosbags` makes and serializes them."""

from functools import cache
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, install_extra
from tb2rl.deploy.ros.messages import BILLION

BUMPER_EVENTS = {1: "kobuki_msgs/msg/BumperEvent", 2: "kobuki_ros_interfaces/msg/BumperEvent"}  # by version of ROS
_MISSING_DEFINITIONS = {  # of message types that the library lacks
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    **dict.fromkeys(BUMPER_EVENTS.values(), "uint8 bumper\nuint8 state"),
}


class BagMessages:
    """Makes and serializes messages of ROS 1 or ROS 2; a `tb2rl.deploy.ros.messages.MessageFactory`."""

    def __init__(self, ros: int) -> None:
        self.ros, self.store = ros, message_types(ros)
        self.seq = 0  # sequence number in the headers of ROS 1

    def make_message(self, type_name: str) -> Any:
        name = type_name.replace("/msg/", "/").replace("/", "/msg/")  # PACKAGE/NAME becomes PACKAGE/msg/NAME
        name = BUMPER_EVENTS[self.ros] if name in BUMPER_EVENTS.values() else name
        _, fields = self.store.fielddefs[name]
        values = {field: self._default_value(kind.name, detail) for field, (kind, detail) in fields}
        if "seq" in values:
            values["seq"] = self.seq
        return self.store.types[name](**values)

    def _default_value(self, kind: str, detail: Any) -> Any:
        if kind == "NAME":
            return self.make_message(detail)
        if kind == "BASE":
            return {"string": "", "bool": False}.get(detail[0], 0)
        (element_kind, element_detail), length = detail
        return np.zeros(length, dtype=element_detail[0]) if element_kind.name == "BASE" else []

    def make_time(self, nanoseconds: int) -> Any:
        seconds, remainder = divmod(nanoseconds, BILLION)
        return self.store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=remainder)

    def make_array(self, values: np.ndarray) -> np.ndarray:
        return values

    def serialize(self, message: Any) -> bytes:
        return (self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr)(message, message.__msgtype__)

    def deserialize(self, raw: bytes, type_name: str) -> Any:
        return (self.store.deserialize_ros1 if self.ros == 1 else self.store.deserialize_cdr)(raw, type_name)


@cache
def message_types(ros: int) -> Any:
    """Return the library's store of message types for a version of ROS."""
    typesys = rosbags_library().typesys
    store = typesys.get_typestore(typesys.Stores["ROS1_NOETIC" if ros == 1 else "ROS2_HUMBLE"])
    for name, definition in _MISSING_DEFINITIONS.items():
        if name not in store.fielddefs:
            store.register(typesys.get_types_from_msg(definition, name))
    return store


def rosbags_library() -> Any:
    """Import the library `rosbags`; raises an `InputError` if it is not installed."""
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2
        import rosbags.typesys
    except ImportError:
        raise InputError(f"bags need the extra `bags`: {install_extra('bags')}") from None
    return rosbags
