"""Writes an episode as a bag: a ROS 1 file, or a ROS 2 folder with an mcap file, with a simulated TurtleBot2's topics.

| topic | message | content |
|---|---|---|
| `/kobuki/laser/scan` | sensor_msgs/LaserScan | the laser; NaN for beams that the task does not use |
| `/odom` | nav_msgs/Odometry | wheel odometry since the start of the episode |
| `/ground_truth` | nav_msgs/Odometry | true pose and speeds, in the frame `map`, which is the world's |
| `/cmd_vel` | geometry_msgs/Twist | command of the policy, at the beginning of each step |
| `/tf` | tf2_msgs/TFMessage | `map` to `odom` to `base_footprint` |
| `/clock` | rosgraph_msgs/Clock | simulated time, the time of all stamps |
| `/bumper` | std_msgs/Bool | whether the base touched anything since the last message |
| `/mobile_base/events/bumper`, in ROS 2 `/events/bumper` | BumperEvent of the Kobuki | press or release of a bumper |
| `/reward` | std_msgs/Float64 | reward of each step |
| `/move_base_simple/goal`, in ROS 2 `/goal_pose` | geometry_msgs/PoseStamped | the goal, for a task that has one |
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import replacing
from tb2rl.deploy.bags.messages import BagMessages, rosbags_library
from tb2rl.deploy.ros import messages as msg
from tb2rl.deploy.ros.protocols import OutgoingMessage
from tb2rl.deploy.ros.topics import TURTLEBOT2, Topics
from tb2rl.envs.scene import Scene
from tb2rl.sensors.bumper import bumper_at
from tb2rl.simulation import RobotState

BEGIN = 1.0  # [s] the clock as an episode begins, because 0 is an invalid time in ROS
MAP, ODOM, BASE = "map", "odom", "base_footprint"  # frames (REP 105); the laser is above the middle of the axle


class Recorder:
    """Writes one episode into an open bag; made by `open_bag`.

    Args:
        bag: Writer of the library.
        messages: Messages of its ROS.
        scene: Scene of the environment.
    """

    def __init__(self, bag: Any, messages: BagMessages, scene: Scene) -> None:
        self._bag, self._messages, self._scene = bag, messages, scene
        self._topics, self._input_topics = Topics(), TURTLEBOT2[messages.ros]
        self._connections: dict[str, Any] = {}
        self._step = 0
        self._pressed: int | None = None  # number of the pressed bumper
        self._all_angles = replace(scene.laser, indices=None).angles

    def reset(self, robot_state: RobotState) -> None:
        """Write the initial robot state of the episode."""
        if self._scene.task.goal_task:
            x, y = robot_state.goal[0].tolist()
            self._write(self._input_topics.goal, msg.Goal(MAP, (x, y), self._now))
        self._write_sensors(robot_state)

    def step(self, command: np.ndarray, reward: float, robot_state: RobotState) -> None:
        """Write a control step: command v [m/s] and w [rad/s], shape (2,), reward, and the robot state after it."""
        self._write(self._topics.velocity, msg.Twist(*command.tolist()))
        self._step += 1
        self._messages.seq = self._step
        self._write_sensors(robot_state)
        self._write_number("/reward", "std_msgs/Float64", reward)

    def _write_sensors(self, robot_state: RobotState) -> None:
        x, y, yaw = robot_state.pose[0].tolist()
        odometry = robot_state.odometry[0].tolist()
        (v, w), (wheel_v, wheel_w) = robot_state.twist[0].tolist(), robot_state.odometry_twist[0].tolist()
        self._write("/clock", msg.Clock(self._now))
        origin = _odometry_origin((x, y, yaw), odometry)
        transforms = (_transform(MAP, ODOM, *origin), _transform(ODOM, BASE, *odometry))
        self._write("/tf", msg.Transforms(self._now, transforms))
        self._write("/ground_truth", msg.Odometry(self._now, MAP, BASE, (x, y, yaw), (v, w)))
        self._write(self._topics.odometry, msg.Odometry(self._now, ODOM, BASE, odometry, (wheel_v, wheel_w)))
        self._write(self._topics.scan, self._scan(robot_state.ranges[0]))
        bumped = bool(robot_state.bumped[0])
        self._write_number("/bumper", "std_msgs/Bool", bumped)
        nearest = self._scene.laser.angles[np.argmin(robot_state.ranges[0])]
        released, self._pressed = self._pressed, bumper_at(nearest) if bumped else None
        for event in msg.bumper_events(released, self._pressed):
            self._write(self._input_topics.bumper, event)

    def _scan(self, used: np.ndarray) -> msg.LaserScan:
        laser, angles = self._scene.laser, self._all_angles
        ranges = np.full(len(angles), math.nan)
        ranges[slice(None) if laser.indices is None else list(laser.indices)] = used
        increment = float(angles[1] - angles[0]) if len(angles) > 1 else 0.0
        period, limits = self._scene.task.control_period, (laser.min_range, laser.max_range)
        return msg.LaserScan(self._now, BASE, float(angles[0]), increment, period, *limits, ranges)

    @property
    def _now(self) -> int:
        """Simulated time [ns]."""
        return round((BEGIN + self._step * self._scene.task.control_period) * msg.BILLION)

    def _write(self, topic: str, message: OutgoingMessage) -> None:
        self._write_ros(topic, message.to_ros(self._messages))

    def _write_number(self, topic: str, kind: str, number: float) -> None:
        message = self._messages.new(kind)
        message.data = number
        self._write_ros(topic, message)

    def _write_ros(self, topic: str, message: Any) -> None:
        if topic not in self._connections:
            store = self._messages.store
            self._connections[topic] = self._bag.add_connection(topic, message.__msgtype__, typestore=store)
        self._bag.write(self._connections[topic], self._now, self._messages.serialize(message))


def _transform(frame: str, child: str, x: float, y: float, yaw: float) -> msg.Transform:
    return msg.Transform(frame, child, (x, y, 0.0), msg.quaternion(yaw))


def _odometry_origin(pose: tuple[float, float, float], odometry: list[float]) -> tuple[float, float, float]:
    """Return the pose x, y, yaw of the odometry frame in the world, for a robot at `pose`."""
    yaw = pose[2] - odometry[2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y = odometry[0] * cos - odometry[1] * sin, odometry[0] * sin + odometry[1] * cos
    return pose[0] - x, pose[1] - y, yaw


def check_bag(path: str | Path) -> Path:
    """Return the path of a bag that can be written.

    Raises:
        InputError: If it cannot, or `rosbags` is not installed.
    """
    path = Path(path)
    rosbags_library()
    if path.suffix not in ("", ".bag"):
        raise InputError(f"a bag is a file .bag (ROS 1), or a folder, named without a dot (ROS 2), got {str(path)!r}")
    if path.exists() and (path.is_dir() or not path.suffix):
        raise InputError(f"cannot write {path}: it exists already; remove it, or take another name")
    folder = path.absolute().parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(f"cannot write {path}: its folder does not exist, or is not writable")
    return path


@contextmanager
def open_bag(path: Path, scene: Scene) -> Iterator[Recorder]:
    """Open a bag for one episode; it appears when the block ends without an error.

    Args:
        path: A path from `check_bag`; an older file is replaced.
        scene: Scene of the environment.

    Raises:
        InputError: If it cannot be written.
    """
    library, messages = rosbags_library(), BagMessages(1 if path.suffix else 2)
    try:
        if messages.ros == 1:
            with replacing(path) as temporary, library.rosbag1.Writer(temporary) as bag:
                yield Recorder(bag, messages, scene)
        else:
            plugin = library.rosbag2.StoragePlugin.MCAP
            with _new_folder(path) as folder, library.rosbag2.Writer(folder, version=8, storage_plugin=plugin) as bag:
                yield Recorder(bag, messages, scene)
    except BrokenPipeError:  # of the terminal, not of the bag
        raise
    except OSError as error:
        raise InputError(one_line(f"cannot write {path}: {error.strerror or error}")) from None


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Make a temporary folder with the name of `path`, because a bag stores its name; move it to `path` at the end."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary / path.name
        (temporary / path.name).rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
