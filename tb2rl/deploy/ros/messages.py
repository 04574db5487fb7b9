"""What travels on topics, as plain values; the messages of ROS 1 and ROS 2 are made of them, and they of those.

Frames are those of REP 103 and REP 105: x forward, y left, angles counter-clockwise, metres and radians; a stamp is in
nanoseconds of the graph's time.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from tb2rl.deploy.portable.policy_contract import are_usable

BILLION = 1_000_000_000  # [ns] in a second
_TOLERANCE = 0.1  # of the length of a quaternion: more than its rounding, and less than what is left empty


class Dialect(Protocol):
    """What ROS 1 and ROS 2 write differently."""

    def new(self, kind: str) -> Any:
        """An empty message of a kind, such as "sensor_msgs/LaserScan"."""

    def time(self, nanoseconds: int) -> Any:
        """A stamp."""

    def octets(self, data: bytes) -> Any:
        """What a field of type uint8[] takes."""


class Message(Protocol):
    """A value that can be published."""

    kind: ClassVar[str]  # of the message: its package and its name

    def to_ros(self, ros: Dialect) -> Any:
        """The message of ROS."""


class Heard(Protocol):
    """A value that can be listened for."""

    kind: ClassVar[str]  # of the message: its package and its name

    @classmethod
    def from_ros(cls, message: Any) -> Self:
        """What a message of ROS says."""


@dataclass(frozen=True)
class Clock:
    """What time it is in the simulation."""

    kind: ClassVar[str] = "rosgraph_msgs/Clock"
    stamp: int  # [ns]

    def to_ros(self, ros: Dialect) -> Any:
        message = ros.new(self.kind)
        message.clock = ros.time(self.stamp)
        return message


@dataclass(frozen=True)
class Velocity:
    """A command to the base."""

    kind: ClassVar[str] = "geometry_msgs/Twist"
    linear: float  # [m/s] forward
    angular: float  # [rad/s] to the left

    @classmethod
    def from_ros(cls, message: Any) -> Velocity:
        """What a message says; numbers that are not finite are no command, and stop the base."""
        speeds = message.linear.x, message.angular.z
        return cls(*speeds) if all(map(math.isfinite, speeds)) else cls(0.0, 0.0)

    def to_ros(self, ros: Dialect) -> Any:
        message = ros.new(self.kind)
        message.linear.x, message.angular.z = self.linear, self.angular
        return message


@dataclass(frozen=True)
class Scan:
    """One sweep of the laser, from right to left."""

    kind: ClassVar[str] = "sensor_msgs/LaserScan"
    stamp: int  # [ns]
    frame: str
    angle_min: float  # [rad] of the first beam
    angle_increment: float  # [rad]
    period: float  # [s] between two scans
    range_min: float  # [m]
    range_max: float  # [m]
    ranges: np.ndarray  # [m] shape (beams,), inf where nothing was hit (REP 117)

    @classmethod
    def from_ros(cls, message: Any) -> Scan:
        sweep = message.angle_min, message.angle_increment, message.scan_time
        limits = message.range_min, message.range_max
        return cls(*_header(message), *sweep, *limits, np.array(message.ranges, dtype=float))

    def to_ros(self, ros: Dialect) -> Any:
        message = _stamped(ros, self.kind, self.stamp, self.frame)
        message.angle_min, message.angle_increment = self.angle_min, self.angle_increment
        message.angle_max = self.angle_min + (len(self.ranges) - 1) * self.angle_increment
        message.scan_time = self.period
        message.range_min, message.range_max = self.range_min, self.range_max
        message.ranges = array("f", self.ranges.astype(np.float32).tobytes())
        return message


@dataclass(frozen=True)
class Odometry:
    """Where the wheels say that the robot is, and how fast."""

    kind: ClassVar[str] = "nav_msgs/Odometry"
    stamp: int  # [ns]
    frame: str  # of the pose
    child: str  # the robot's, of the speeds
    pose: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    twist: tuple[float, float]  # forward [m/s], to the left [rad/s]

    @classmethod
    def from_ros(cls, message: Any) -> Odometry:
        """What a message says; the yaw is NaN if the orientation is no rotation."""
        position, turn, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
        pose, speeds = (position.x, position.y, _yaw(turn)), (twist.linear.x, twist.angular.z)
        return cls(*_header(message), message.child_frame_id, pose, speeds)

    @property
    def is_usable(self) -> bool:
        """Whether a robot may drive by its numbers."""
        return are_usable((*self.pose, *self.twist))

    def to_ros(self, ros: Dialect) -> Any:
        message = _stamped(ros, self.kind, self.stamp, self.frame)
        message.child_frame_id = self.child
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y, _ = self.pose
        _turn(pose.orientation, upright(self.pose[2]))
        twist.linear.x, twist.angular.z = self.twist
        return message


@dataclass(frozen=True)
class Transform:
    """Where a frame is in its parent."""

    frame: str
    child: str
    place: tuple[float, float, float]  # x, y, z [m]
    rotation: tuple[float, float, float, float]  # quaternion x, y, z, w


@dataclass(frozen=True)
class Transforms:
    """Where some frames are at one instant."""

    kind: ClassVar[str] = "tf2_msgs/TFMessage"
    stamp: int  # [ns]
    transforms: tuple[Transform, ...]

    def to_ros(self, ros: Dialect) -> Any:
        message = ros.new(self.kind)
        message.transforms = [self._to_ros(ros, each) for each in self.transforms]
        return message

    def _to_ros(self, ros: Dialect, transform: Transform) -> Any:
        message = _stamped(ros, "geometry_msgs/TransformStamped", self.stamp, transform.frame)
        message.child_frame_id = transform.child
        place = message.transform.translation
        place.x, place.y, place.z = transform.place
        _turn(message.transform.rotation, transform.rotation)
        return message


@dataclass(frozen=True)
class Image:
    """What the camera sees: colours, uint8 (height, width, 3), or depths [m], float32 (height, width)."""

    kind: ClassVar[str] = "sensor_msgs/Image"
    stamp: int  # [ns]
    frame: str
    pixels: np.ndarray

    def to_ros(self, ros: Dialect) -> Any:
        message = _stamped(ros, self.kind, self.stamp, self.frame)
        message.height, message.width = self.pixels.shape[:2]
        message.encoding = "32FC1" if self.pixels.ndim == 2 else "rgb8"
        message.step = self.pixels.strides[0]
        message.data = ros.octets(self.pixels.tobytes())
        return message


@dataclass(frozen=True)
class Bump:
    """One of the three bumpers is pressed, or let go again."""

    kind: ClassVar[str] = "kobuki_msgs/BumperEvent"
    bumper: int  # 0 left, 1 in the middle, 2 right
    pressed: bool

    @classmethod
    def from_ros(cls, message: Any) -> Bump:
        return cls(message.bumper, bool(message.state))

    def to_ros(self, ros: Dialect) -> Any:
        message = ros.new(self.kind)
        message.bumper, message.state = self.bumper, int(self.pressed)
        return message


@dataclass(frozen=True)
class Goal:
    """Where somebody wants the robot."""

    kind: ClassVar[str] = "geometry_msgs/PoseStamped"
    frame: str
    place: tuple[float, float]  # x, y [m]

    @classmethod
    def from_ros(cls, message: Any) -> Goal:
        return cls(_header(message)[1], (message.pose.position.x, message.pose.position.y))


@dataclass(frozen=True)
class Plan:
    """The way there."""

    kind: ClassVar[str] = "nav_msgs/Path"
    frame: str
    points: np.ndarray  # x, y [m], shape (points, 2)

    @classmethod
    def from_ros(cls, message: Any) -> Plan:
        points = [(each.pose.position.x, each.pose.position.y) for each in message.poses]
        return cls(_header(message)[1], np.array(points, dtype=float).reshape(-1, 2))


@dataclass(frozen=True)
class Report:
    """How a program is, for who watches a robot."""

    kind: ClassVar[str] = "diagnostic_msgs/DiagnosticArray"
    stamp: int  # [ns]
    level: str  # OK, WARN or ERROR
    name: str
    sentence: str
    values: dict[str, str]

    def to_ros(self, ros: Dialect) -> Any:
        message, status = _stamped(ros, self.kind, self.stamp, ""), ros.new("diagnostic_msgs/DiagnosticStatus")
        status.level, status.name, status.message = getattr(status, self.level), self.name, self.sentence
        for key, value in self.values.items():
            pair = ros.new("diagnostic_msgs/KeyValue")
            pair.key, pair.value = key, value
            status.values.append(pair)
        message.status = [status]
        return message


RARE: frozenset[Any] = frozenset({Transforms, Bump, Report})  # not installed with every ROS; all can do without
SENSED: frozenset[Any] = frozenset({Scan, Odometry})  # only the newest counts


def upright(yaw: float) -> tuple[float, float, float, float]:
    """The quaternion x, y, z, w of a turn to the left [rad]."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def _yaw(turn: Any) -> float:
    """The turn to the left of a quaternion [rad]; NaN if that is none: its length is not about 1."""
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    if not abs(math.hypot(x, y, z, w) - 1.0) <= _TOLERANCE:
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2)


def _stamped(ros: Dialect, kind: str, stamp: int, frame: str) -> Any:
    message = ros.new(kind)
    message.header.stamp, message.header.frame_id = ros.time(stamp), frame
    return message


def _header(message: Any) -> tuple[int, str]:
    """The stamp [ns] and the frame; ROS 1 wrote frames with a slash, once."""
    stamp = message.header.stamp
    seconds, rest = (stamp.secs, stamp.nsecs) if hasattr(stamp, "secs") else (stamp.sec, stamp.nanosec)
    return seconds * BILLION + rest, message.header.frame_id.lstrip("/")


def _turn(rotation: Any, quaternion: tuple[float, float, float, float]) -> None:
    rotation.x, rotation.y, rotation.z, rotation.w = quaternion
