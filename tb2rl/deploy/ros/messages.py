"""Messages as plain values that convert from and to those of ROS 1, ROS 2 and bags.

Frames follow REP 103 and REP 105: x forward, y left, angles counter-clockwise, metres and radians. A stamp counts the
nanoseconds of the ROS time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tb2rl.deploy.portable.policy_contract import are_usable
from tb2rl.deploy.portable.scan import Scan
from tb2rl.deploy.ros.protocols import MessageFactory

BILLION = 1_000_000_000  # [ns] in a second
_TOLERANCE = 0.1  # of the length of a quaternion: more than rounding, less than the length of an empty one


@dataclass(frozen=True)
class Clock:
    """Simulated time."""

    kind: ClassVar[str] = "rosgraph_msgs/Clock"
    stamp: int  # [ns]

    def to_ros(self, ros: MessageFactory) -> Any:
        message = ros.new(self.kind)
        message.clock = ros.time(self.stamp)
        return message


@dataclass(frozen=True)
class Twist:
    """A velocity command."""

    kind: ClassVar[str] = "geometry_msgs/Twist"
    linear: float  # [m/s] forward
    angular: float  # [rad/s] to the left

    @classmethod
    def from_ros(cls, message: Any) -> Twist:
        """Convert a message; a command with a number that is not finite stops the base."""
        speeds = message.linear.x, message.angular.z
        return cls(*speeds) if all(map(math.isfinite, speeds)) else cls(0.0, 0.0)

    def to_ros(self, ros: MessageFactory) -> Any:
        message = ros.new(self.kind)
        message.linear.x, message.angular.z = self.linear, self.angular
        return message


@dataclass(frozen=True)
class LaserScan:
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
    def from_ros(cls, message: Any) -> LaserScan:
        sweep = message.angle_min, message.angle_increment, message.scan_time
        limits = message.range_min, message.range_max
        return cls(*_header(message), *sweep, *limits, np.array(message.ranges, dtype=float))

    def to_ros(self, ros: MessageFactory) -> Any:
        message = _stamped(ros, self.kind, self.stamp, self.frame)
        message.angle_min, message.angle_increment = self.angle_min, self.angle_increment
        message.angle_max = self.angle_min + (len(self.ranges) - 1) * self.angle_increment
        message.scan_time = self.period
        message.range_min, message.range_max = self.range_min, self.range_max
        message.ranges = ros.float32_array(self.ranges)
        return message

    def to_scan(self) -> Scan:
        """Convert it to what a driver takes."""
        return Scan(self.ranges, self.angle_min, self.angle_increment, self.range_min, self.range_max)


@dataclass(frozen=True)
class Odometry:
    """Pose and speeds."""

    kind: ClassVar[str] = "nav_msgs/Odometry"
    stamp: int  # [ns]
    frame: str  # of the pose
    child: str  # frame of the speeds: the robot's
    pose: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    twist: tuple[float, float]  # forward [m/s], to the left [rad/s]

    @classmethod
    def from_ros(cls, message: Any) -> Odometry:
        """Convert a message; the yaw is NaN if the orientation is no rotation."""
        position, rotation, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
        pose, speeds = (position.x, position.y, _yaw(rotation)), (twist.linear.x, twist.angular.z)
        return cls(*_header(message), message.child_frame_id, pose, speeds)

    @property
    def is_usable(self) -> bool:
        """Whether all numbers are finite and of a plausible size."""
        return are_usable((*self.pose, *self.twist))

    def to_ros(self, ros: MessageFactory) -> Any:
        message = _stamped(ros, self.kind, self.stamp, self.frame)
        message.child_frame_id = self.child
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y, _ = self.pose
        _set_rotation(pose.orientation, quaternion(self.pose[2]))
        twist.linear.x, twist.angular.z = self.twist
        return message


@dataclass(frozen=True)
class Transform:
    """Pose of a frame in its parent."""

    frame: str
    child: str
    translation: tuple[float, float, float]  # x, y, z [m]
    rotation: tuple[float, float, float, float]  # quaternion x, y, z, w


@dataclass(frozen=True)
class Transforms:
    """Poses of frames at one instant."""

    kind: ClassVar[str] = "tf2_msgs/TFMessage"
    stamp: int  # [ns]
    transforms: tuple[Transform, ...]

    def to_ros(self, ros: MessageFactory) -> Any:
        message = ros.new(self.kind)
        message.transforms = []
        for each in self.transforms:
            stamped = _stamped(ros, "geometry_msgs/TransformStamped", self.stamp, each.frame)
            stamped.child_frame_id = each.child
            translation = stamped.transform.translation
            translation.x, translation.y, translation.z = each.translation
            _set_rotation(stamped.transform.rotation, each.rotation)
            message.transforms.append(stamped)
        return message


@dataclass(frozen=True)
class Image:
    """A camera image: colours, uint8 (height, width, 3), or depths [m], float32 (height, width)."""

    kind: ClassVar[str] = "sensor_msgs/Image"
    stamp: int  # [ns]
    frame: str
    pixels: np.ndarray

    def to_ros(self, ros: MessageFactory) -> Any:
        message = _stamped(ros, self.kind, self.stamp, self.frame)
        message.height, message.width = self.pixels.shape[:2]
        message.encoding = "32FC1" if self.pixels.ndim == 2 else "rgb8"
        message.step = self.pixels.strides[0]
        message.data = ros.uint8_array(self.pixels.tobytes())
        return message


@dataclass(frozen=True)
class BumperEvent:
    """Press or release of one of the three bumpers."""

    kind: ClassVar[str] = "kobuki_msgs/BumperEvent"
    bumper: int  # 0 left, 1 in the middle, 2 right
    pressed: bool

    @classmethod
    def from_ros(cls, message: Any) -> BumperEvent:
        return cls(message.bumper, bool(message.state))

    def to_ros(self, ros: MessageFactory) -> Any:
        message = ros.new(self.kind)
        message.bumper, message.state = self.bumper, int(self.pressed)
        return message


@dataclass(frozen=True)
class Goal:
    """A goal position."""

    kind: ClassVar[str] = "geometry_msgs/PoseStamped"
    frame: str
    position: tuple[float, float]  # x, y [m]
    stamp: int = 0  # [ns]

    @classmethod
    def from_ros(cls, message: Any) -> Goal:
        stamp, frame = _header(message)
        return cls(frame, (message.pose.position.x, message.pose.position.y), stamp)

    def to_ros(self, ros: MessageFactory) -> Any:
        message = _stamped(ros, self.kind, self.stamp, self.frame)
        message.pose.position.x, message.pose.position.y = self.position
        message.pose.orientation.w = 1.0
        return message


@dataclass(frozen=True)
class Plan:
    """A planned path to a goal."""

    kind: ClassVar[str] = "nav_msgs/Path"
    frame: str
    points: np.ndarray  # x, y [m], shape (points, 2)

    @classmethod
    def from_ros(cls, message: Any) -> Plan:
        points = [(each.pose.position.x, each.pose.position.y) for each in message.poses]
        return cls(_header(message)[1], np.array(points, dtype=float).reshape(-1, 2))


@dataclass(frozen=True)
class Diagnostics:
    """Diagnostic status of a node."""

    kind: ClassVar[str] = "diagnostic_msgs/DiagnosticArray"
    stamp: int  # [ns]
    level: str  # OK, WARN or ERROR
    name: str
    summary: str
    values: dict[str, str]

    def to_ros(self, ros: MessageFactory) -> Any:
        message, status = _stamped(ros, self.kind, self.stamp, ""), ros.new("diagnostic_msgs/DiagnosticStatus")
        status.level, status.name, status.message = getattr(status, self.level), self.name, self.summary
        for key, value in self.values.items():
            pair = ros.new("diagnostic_msgs/KeyValue")
            pair.key, pair.value = key, value
            status.values.append(pair)
        message.status = [status]
        return message


OPTIONAL: frozenset[Any] = frozenset({Transforms, BumperEvent, Diagnostics})  # some installations of ROS lack these
LATEST_ONLY: frozenset[Any] = frozenset({LaserScan, Odometry})  # a new message replaces one that waits


def bumper_events(released: int | None, pressed: int | None) -> list[BumperEvent]:
    """Return the events between two instants, each with the number of the pressed bumper or None."""
    if released == pressed:
        return []
    changes = ((released, False), (pressed, True))
    return [BumperEvent(bumper, state) for bumper, state in changes if bumper is not None]


def quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion x, y, z, w of a turn to the left [rad]."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def _yaw(rotation: Any) -> float:
    """Return the yaw of a quaternion [rad]; NaN if its length is not about 1."""
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    if not abs(math.hypot(x, y, z, w) - 1.0) <= _TOLERANCE:
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2)


def _set_rotation(rotation: Any, values: tuple[float, float, float, float]) -> None:
    rotation.x, rotation.y, rotation.z, rotation.w = values


def _stamped(ros: MessageFactory, kind: str, stamp: int, frame: str) -> Any:
    message = ros.new(kind)
    message.header.stamp, message.header.frame_id = ros.time(stamp), frame
    return message


def _header(message: Any) -> tuple[int, str]:
    """Return stamp [ns] and frame; early versions of ROS 1 put a slash before frames."""
    stamp = message.header.stamp
    seconds, rest = (stamp.secs, stamp.nsecs) if hasattr(stamp, "secs") else (stamp.sec, stamp.nanosec)
    return seconds * BILLION + rest, message.header.frame_id.lstrip("/")
