"""An episode as a bag: a ROS 1 file, or a ROS 2 folder with an mcap file, with the topics of a simulated TurtleBot2.

| topic | message | what |
|---|---|---|
| `/kobuki/laser/scan` | sensor_msgs/LaserScan | the laser; NaN where the task does not read a beam |
| `/odom` | nav_msgs/Odometry | by the wheels, from where the episode began |
| `/ground_truth` | nav_msgs/Odometry | the true pose and speed, in the frame `map`, which is the world's |
| `/cmd_vel` | geometry_msgs/Twist | what the policy says, at the beginning of each step |
| `/tf` | tf2_msgs/TFMessage | `map` to `odom` to `base_footprint` |
| `/clock` | rosgraph_msgs/Clock | simulated time, which all stamps are in |
| `/bumper` | std_msgs/Bool | whether the base touched anything since the last message |
| `/mobile_base/events/bumper`, in ROS 2 `/events/bumper` | BumperEvent of the Kobuki | a bumper is pressed or let go |
| `/reward` | std_msgs/Float64 | of each step |
| `/move_base_simple/goal`, in ROS 2 `/goal_pose` | geometry_msgs/PoseStamped | the goal, of a task that has one |
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
from tb2rl.deploy.bags.topics import BUMPER_EVENTS, message_types, rosbags_library
from tb2rl.envs.scene import Scene
from tb2rl.sensors.bumper import bumper_at
from tb2rl.simulation import RobotState

BEGIN = 1.0  # [s] the clock as an episode begins: in ROS, 0 means that there is no time yet
_TOPICS = {1: ("/move_base_simple/goal", "/mobile_base/events/bumper"), 2: ("/goal_pose", "/events/bumper")}
MAP, ODOM, BASE = "map", "odom", "base_footprint"  # frames (REP 105); the laser is above the middle of the axle


class Recorder:
    """Writes one episode into a bag that is open; made by `open_bag`.

    Args:
        bag: A writer of the library.
        store: The message types of its ROS.
        serialize: From a message and its type to bytes.
        ros: Which, 1 or 2.
        scene: Of the environment.
    """

    def __init__(self, bag: Any, store: Any, serialize: Any, ros: int, scene: Scene) -> None:
        self._bag, self._serialize, self._store = bag, serialize, store
        self._goal_topic, self._bumper_topic = _TOPICS[ros]
        self._event, self._scene = BUMPER_EVENTS[ros].replace("/msg/", "/"), scene
        self._pressed: int | None = None  # which of the bumpers
        self._connections: dict[str, Any] = {}
        self._step = 0
        self._whole = replace(scene.laser, indices=None).angles
        self._new = {name.replace("/msg/", "/"): made for name, made in store.types.items()}

    def begin(self, robot_state: RobotState) -> None:
        """The first reading of the episode."""
        if self._scene.task.goal_task:
            pose = self._pose(np.array([*robot_state.goal[0], 0.0]))
            self._write(self._goal_topic, "geometry_msgs/PoseStamped", header=self._header(MAP), pose=pose)
        self._sense(robot_state)

    def step(self, command: np.ndarray, reward: float, robot_state: RobotState) -> None:
        """A control step.

        Args:
            command: What the policy said, v [m/s] and w [rad/s], shape (2,).
            reward: Of the step.
            robot_state: What it led to.
        """
        v, w = command.tolist()
        self._write("/cmd_vel", "geometry_msgs/Twist", linear=self._vector(v), angular=self._vector(0.0, 0.0, w))
        self._step += 1
        self._sense(robot_state)
        self._write("/reward", "std_msgs/Float64", data=reward)

    def _sense(self, robot_state: RobotState) -> None:
        pose, odometry = robot_state.pose[0], robot_state.odometry[0]
        self._write("/clock", "rosgraph_msgs/Clock", clock=self._time())
        transforms = [self._transform(MAP, ODOM, _difference(pose, odometry)), self._transform(ODOM, BASE, odometry)]
        self._write("/tf", "tf2_msgs/TFMessage", transforms=transforms)
        self._write_odometry("/ground_truth", MAP, pose, robot_state.twist[0])
        self._write_odometry("/odom", ODOM, odometry, robot_state.odometry_twist[0])
        self._write("/kobuki/laser/scan", "sensor_msgs/LaserScan", **self._scan(robot_state.ranges[0]))
        self._write("/bumper", "std_msgs/Bool", data=bool(robot_state.bumped[0]))
        nearest = self._scene.laser.angles[np.argmin(robot_state.ranges[0])]
        self._press(bumper_at(nearest) if robot_state.bumped[0] else None)

    def _press(self, bumper: int | None) -> None:
        """Say which bumper was let go and which is pressed now, if that is another."""
        if bumper != self._pressed:
            for which, state in ((self._pressed, 0), (bumper, 1)):
                if which is not None:
                    self._write(self._bumper_topic, self._event, bumper=which, state=state)
            self._pressed = bumper

    def _write_odometry(self, topic: str, frame: str, pose: np.ndarray, twist: np.ndarray) -> None:
        v, w = twist.tolist()
        unknown = np.zeros(36)
        moving = self._new["geometry_msgs/Twist"](linear=self._vector(v), angular=self._vector(0.0, 0.0, w))
        self._write(
            topic,
            "nav_msgs/Odometry",
            header=self._header(frame),
            child_frame_id=BASE,
            pose=self._new["geometry_msgs/PoseWithCovariance"](pose=self._pose(pose), covariance=unknown),
            twist=self._new["geometry_msgs/TwistWithCovariance"](twist=moving, covariance=unknown),
        )

    def _scan(self, read: np.ndarray) -> dict[str, Any]:
        laser, angles = self._scene.laser, self._whole
        ranges = np.full(len(angles), math.nan, dtype=np.float32)
        ranges[slice(None) if laser.indices is None else list(laser.indices)] = read
        return {
            "header": self._header(BASE),
            "angle_min": float(angles[0]),
            "angle_max": float(angles[-1]),
            "angle_increment": float(angles[1] - angles[0]) if len(angles) > 1 else 0.0,
            "time_increment": 0.0,
            "scan_time": self._scene.task.control_period,
            "range_min": laser.min_range,
            "range_max": laser.max_range,
            "ranges": ranges,
            "intensities": np.empty(0, dtype=np.float32),
        }

    def _transform(self, frame: str, child: str, pose: np.ndarray) -> Any:
        placed = self._pose(pose)
        shift = self._vector(placed.position.x, placed.position.y)
        moved = self._new["geometry_msgs/Transform"](translation=shift, rotation=placed.orientation)
        header = self._header(frame)
        return self._new["geometry_msgs/TransformStamped"](header=header, child_frame_id=child, transform=moved)

    def _pose(self, pose: np.ndarray) -> Any:
        x, y, yaw = pose.tolist()
        turned = self._new["geometry_msgs/Quaternion"](x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        point = self._new["geometry_msgs/Point"](x=x, y=y, z=0.0)
        return self._new["geometry_msgs/Pose"](position=point, orientation=turned)

    def _vector(self, x: float, y: float = 0.0, z: float = 0.0) -> Any:
        return self._new["geometry_msgs/Vector3"](x=x, y=y, z=z)

    def _header(self, frame: str) -> Any:
        number = {"seq": self._step} if "seq" in self._new["std_msgs/Header"].__annotations__ else {}  # ROS 1
        return self._new["std_msgs/Header"](stamp=self._time(), frame_id=frame, **number)

    def _time(self) -> Any:
        seconds, nanoseconds = divmod(self._now, 10**9)
        return self._new["builtin_interfaces/Time"](sec=seconds, nanosec=nanoseconds)

    @property
    def _now(self) -> int:
        """The simulated time [ns]."""
        return round((BEGIN + self._step * self._scene.task.control_period) * 1e9)

    def _write(self, topic: str, kind: str, **fields: Any) -> None:
        name = kind.replace("/", "/msg/")
        if topic not in self._connections:
            self._connections[topic] = self._bag.add_connection(topic, name, typestore=self._store)
        self._bag.write(self._connections[topic], self._now, self._serialize(self._new[kind](**fields), name))


def _difference(pose: np.ndarray, odometry: np.ndarray) -> np.ndarray:
    """Where the frame that `odometry` is in lies, if the robot is at `pose`: x, y, yaw, shape (3,)."""
    yaw = pose[2] - odometry[2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y = odometry[0] * cos - odometry[1] * sin, odometry[0] * sin + odometry[1] * cos
    return np.array([pose[0] - x, pose[1] - y, yaw])


def check_bag(path: str | Path) -> Path:
    """The path of a bag that can be written.

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
        raise InputError(f"cannot write {path}: its folder does not exist, or takes no files")
    return path


@contextmanager
def open_bag(path: Path, scene: Scene) -> Iterator[Recorder]:
    """A bag to record one episode into; it is there once the block ends well.

    Args:
        path: As `check_bag` takes it; an older file is replaced.
        scene: Of the environment that is recorded.

    Raises:
        InputError: If it cannot be written.
    """
    library = rosbags_library()
    store = message_types(library, first=bool(path.suffix))
    try:
        if path.suffix:
            with replacing(path) as temporary, library.rosbag1.Writer(temporary) as bag:
                yield Recorder(bag, store, store.serialize_ros1, 1, scene)
        else:
            plugin = library.rosbag2.StoragePlugin.MCAP
            with _new_folder(path) as folder, library.rosbag2.Writer(folder, version=8, storage_plugin=plugin) as bag:
                yield Recorder(bag, store, store.serialize_cdr, 2, scene)
    except BrokenPipeError:  # not of the bag: whoever reads what is printed went away
        raise
    except OSError as error:
        raise InputError(one_line(f"cannot write {path}: {error.strerror or error}")) from None


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """A folder of the same name elsewhere, which becomes `path` once the block ends well: a bag knows its name."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary / path.name
        (temporary / path.name).rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
