"""Plain values for ROS messages, with conversions from and to the messages of ROS 1, ROS 2 and bags.

Frames follow REP 103 and REP 105: x forward, y left, angles counter-clockwise, metres and radians. Stamps are ROS time
in nanoseconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Protocol, Self, dataclass_transform, get_type_hints

import numpy as np

from tb2rl.deploy.portable.scan_reader import Scan
from tb2rl.robots import Laser

BILLION = 1_000_000_000  # [ns] in a second
_TRANSLATION = [f"transform.translation.{axis}" for axis in "xyz"]
_ROTATION = [f"transform.rotation.{part}" for part in "xyzw"]
_MAX_LENGTH_ERROR = 0.1  # of a quaternion; its length should be 1


class MessageFactory(Protocol):
    """Makes empty messages of one version of ROS, and values for their fields."""

    def make_message(self, type_name: str) -> Any: ...
    def make_time(self, nanoseconds: int) -> Any: ...
    def make_array(self, values: np.ndarray) -> Any: ...


@dataclass_transform(frozen_default=True)
class Message:
    """A ROS message as a plain value; subclasses become frozen dataclasses.

    The annotation of a field contains the path of the field in the ROS message, or the paths of the items of a tuple.
    """

    type_name: ClassVar[str]  # in ROS, such as "sensor_msgs/LaserScan"
    optional: ClassVar[bool] = False  # whether some installations of ROS lack this type
    latest_only: ClassVar[bool] = False  # whether a subscriber needs only the newest message
    _paths: ClassVar[dict[str, tuple[str, ...]]]  # by field

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True)(cls)
        hints = get_type_hints(cls, include_extras=True)
        cls._paths = {name: hint.__metadata__ for name, hint in hints.items() if hasattr(hint, "__metadata__")}

    @classmethod
    def from_ros(cls, message: Any) -> Self:
        """Convert a ROS message."""
        fields = {name: tuple(_read(message, path) for path in paths) for name, paths in cls._paths.items()}
        return cls(**{name: values if len(values) > 1 else values[0] for name, values in fields.items()})

    def to_ros(self, factory: MessageFactory) -> Any:
        """Make a ROS message."""
        message = factory.make_message(self.type_name)
        for name, paths in self._paths.items():
            value = getattr(self, name)
            for path, item in zip(paths, value if len(paths) > 1 else (value,), strict=True):
                _write(message, path, item, factory)
        return message


class _Stamped(Message):
    """A message with a header."""

    stamp: Annotated[int, "header.stamp"]  # [ns]
    frame: Annotated[str, "header.frame_id"]


class Clock(Message):
    """Simulated time."""

    type_name = "rosgraph_msgs/Clock"
    stamp: Annotated[int, "clock"]  # [ns]


class Twist(Message):
    """A velocity command."""

    type_name = "geometry_msgs/Twist"
    linear: Annotated[float, "linear.x"]  # [m/s] forward
    angular: Annotated[float, "angular.z"]  # [rad/s] to the left

    @classmethod
    def from_ros(cls, message: Any) -> Twist:
        """Convert a message; a command with a number that is not finite becomes a stop."""
        speeds = message.linear.x, message.angular.z
        return cls(*speeds) if all(map(math.isfinite, speeds)) else cls(0.0, 0.0)


class LaserScan(_Stamped):
    """One sweep of a laser, from right to left if `angle_increment` is positive."""

    type_name, latest_only = "sensor_msgs/LaserScan", True
    angle_min: Annotated[float, "angle_min"]  # [rad] of the first beam
    angle_increment: Annotated[float, "angle_increment"]  # [rad]
    period: Annotated[float, "scan_time"]  # [s] between two scans
    range_min: Annotated[float, "range_min"]  # [m]
    range_max: Annotated[float, "range_max"]  # [m]
    ranges: Annotated[np.ndarray, "ranges"]  # [m] shape (beams,), inf where nothing was hit (REP 117)

    @classmethod
    def of(cls, laser: Laser, stamp: int, frame: str, period: float, ranges: np.ndarray) -> LaserScan:
        """Make the scan of a laser with evenly spread beams."""
        first, last = float(laser.angles[0]), float(laser.angles[-1])
        increment = (last - first) / max(1, len(laser.angles) - 1)
        return cls(stamp, frame, first, increment, period, laser.min_range, laser.max_range, ranges)

    def to_ros(self, factory: MessageFactory) -> Any:
        message = super().to_ros(factory)
        message.angle_max = self.angle_min + (len(self.ranges) - 1) * self.angle_increment
        return message

    def to_scan(self) -> Scan:
        """Make the scan for a driver."""
        return Scan(self.ranges, self.angle_min, self.angle_increment, self.range_min, self.range_max)


class Odometry(_Stamped):
    """Pose in the frame of the header, and speeds in the child frame."""

    type_name, latest_only = "nav_msgs/Odometry", True
    child_frame: Annotated[str, "child_frame_id"]
    # x [m], y [m], yaw [rad]; the yaw is NaN if the quaternion does not have length 1.
    pose: Annotated[tuple[float, float, float], "pose.pose.position.x", "pose.pose.position.y", "pose.pose.orientation"]
    twist: Annotated[tuple[float, float], "twist.twist.linear.x", "twist.twist.angular.z"]  # [m/s], [rad/s] to the left


class Transform(_Stamped):
    """Pose of a child frame in the frame of the header."""

    type_name = "geometry_msgs/TransformStamped"
    child_frame: Annotated[str, "child_frame_id"]
    translation: Annotated[tuple[float, float, float], *_TRANSLATION]  # x, y, z [m]
    rotation: Annotated[tuple[float, float, float, float], *_ROTATION]  # quaternion x, y, z, w


class Transforms(Message):
    """Poses of several frames at one time."""

    type_name, optional = "tf2_msgs/TFMessage", True
    transforms: tuple[Transform, ...]

    def to_ros(self, factory: MessageFactory) -> Any:
        message = factory.make_message(self.type_name)
        message.transforms = [transform.to_ros(factory) for transform in self.transforms]
        return message


class Image(_Stamped):
    """A camera image: RGB, uint8 (height, width, 3), or depth [m], float32 (height, width)."""

    type_name = "sensor_msgs/Image"
    pixels: np.ndarray

    def to_ros(self, factory: MessageFactory) -> Any:
        message = super().to_ros(factory)
        message.height, message.width = self.pixels.shape[:2]
        message.encoding = "32FC1" if self.pixels.ndim == 2 else "rgb8"
        message.step = self.pixels.strides[0]
        message.data = factory.make_array(np.frombuffer(self.pixels.tobytes(), np.uint8))
        return message


class Goal(_Stamped):
    """A goal position."""

    type_name = "geometry_msgs/PoseStamped"
    position: Annotated[tuple[float, float], "pose.position.x", "pose.position.y"]  # [m]

    def to_ros(self, factory: MessageFactory) -> Any:
        message = super().to_ros(factory)
        message.pose.orientation.w = 1.0
        return message


class Plan(Message):
    """A planned path to a goal."""

    type_name = "nav_msgs/Path"
    frame: str
    points: np.ndarray  # x, y [m], shape (points, 2)

    @classmethod
    def from_ros(cls, message: Any) -> Plan:
        points = [(stamped.pose.position.x, stamped.pose.position.y) for stamped in message.poses]
        return cls(_read(message, "header.frame_id"), np.array(points, dtype=float).reshape(-1, 2))


class Diagnostics(Message):
    """Diagnostic status of a node."""

    type_name, optional = "diagnostic_msgs/DiagnosticArray", True
    stamp: Annotated[int, "header.stamp"]  # [ns]
    level: str  # OK, WARN or ERROR
    name: str
    summary: str
    values: dict[str, str]

    def to_ros(self, factory: MessageFactory) -> Any:
        message, status = super().to_ros(factory), factory.make_message("diagnostic_msgs/DiagnosticStatus")
        status.level, status.name, status.message = getattr(status, self.level), self.name, self.summary
        for key, value in self.values.items():
            pair = factory.make_message("diagnostic_msgs/KeyValue")
            pair.key, pair.value = key, value
            status.values.append(pair)
        message.status = [status]
        return message


def quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion x, y, z, w of a yaw [rad]."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def _yaw(rotation: Any) -> float:
    """Return the yaw of a quaternion [rad]; NaN if the length of the quaternion is not about 1."""
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    if not abs(math.hypot(x, y, z, w) - 1.0) <= _MAX_LENGTH_ERROR:
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2)


def _nanoseconds(stamp: Any) -> int:
    is_ros1 = hasattr(stamp, "secs")
    return stamp.secs * BILLION + stamp.nsecs if is_ros1 else stamp.sec * BILLION + stamp.nanosec


_CONVERTERS: Mapping[str, Callable[[Any], Any]] = {  # by the last part of a path
    "clock": _nanoseconds,
    "frame_id": lambda frame: frame.lstrip("/"),  # early versions of ROS 1 put a slash before frames
    "orientation": _yaw,
    "ranges": lambda ranges: np.array(ranges, dtype=float),
    "stamp": _nanoseconds,
    "state": bool,
}


def _read(message: Any, path: str) -> Any:
    value = attrgetter(path)(message)
    name = path.rpartition(".")[2]
    return _CONVERTERS[name](value) if name in _CONVERTERS else value


def _write(message: Any, path: str, value: Any, factory: MessageFactory) -> None:
    parent, _, name = path.rpartition(".")
    owner = attrgetter(parent)(message) if parent else message
    if name == "orientation":
        rotation = owner.orientation
        rotation.x, rotation.y, rotation.z, rotation.w = quaternion(value)
        return
    if name in ("clock", "stamp"):
        value = factory.make_time(value)
    elif name == "ranges":
        value = factory.make_array(value.astype(np.float32))
    setattr(owner, name, value)
