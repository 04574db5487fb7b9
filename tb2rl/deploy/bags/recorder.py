"""Records an episode as a ROS bag: a file (ROS 1), or a folder with an mcap file (ROS 2).

Odometry and scans have a time in the bag that is later than their stamp by the robot's observation latency.

| topic | message | content |
|---|---|---|
| `/kobuki/laser/scan` | sensor_msgs/LaserScan | the laser; NaN for beams that the task does not use |
| `/odom` | nav_msgs/Odometry | wheel odometry since the start of the episode |
| `/ground_truth` | nav_msgs/Odometry | true pose and speeds in the frame `map` of the world |
| `/cmd_vel` | geometry_msgs/Twist | command to the base, after the filters, at the beginning of each step |
| `/tf` | tf2_msgs/TFMessage | `map` to `odom` to `base_footprint` |
| `/clock` | rosgraph_msgs/Clock | simulated time, as in all stamps |
| `/bumper` | std_msgs/Bool | whether the base had contact since the last message |
| `/mobile_base/events/bumper`, in ROS 2 `/events/bumper` | BumperEvent of the Kobuki | press or release of a bumper |
| `/reward` | std_msgs/Float64 | reward of each step |
| `/move_base_simple/goal`, in ROS 2 `/goal_pose` | geometry_msgs/PoseStamped | the goal, for a task that has one |
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tb2rl.deploy.bags.reading import moved
from tb2rl.deploy.bags.writing import BagWriter, open_writer
from tb2rl.deploy.ros import messages as msg
from tb2rl.deploy.ros.events import bumper_events
from tb2rl.deploy.ros.topics import TURTLEBOT2, Topics
from tb2rl.envs.scene import Scene
from tb2rl.sensors.motion import bumper_at
from tb2rl.simulation import RobotState

START_TIME = 1.0  # [s] simulated time at the start of an episode, because 0 is an invalid time in ROS
MAP, ODOM, BASE = "map", "odom", "base_footprint"  # frames (REP 105)


class Recorder:
    """Writes one episode to an open bag; `open_bag` makes it."""

    def __init__(self, writer: BagWriter, scene: Scene) -> None:
        self._writer, self._messages, self._scene = writer, writer.messages, scene
        self._topics, self._driver_topics = Topics(), TURTLEBOT2[self._messages.ros]
        self._step = 0
        self._pressed_bumper: int | None = None
        self._age = 0  # [ns] from the stamp of odometry and scans to their time in the bag, the observation latency

    def reset(self, robot_state: RobotState) -> None:
        """Write the initial robot state of the episode."""
        if self._scene.task.goal_task:
            self._write(self._driver_topics.goal, msg.Goal(self._now, MAP, robot_state.goal[0].tolist()))
        latency = robot_state.initial_state.records["observation_latency"][0]
        self._age = round(latency * self._scene.task.control_period * msg.BILLION)
        self._write_sensors(robot_state)

    def step(self, command: np.ndarray, reward: float, robot_state: RobotState) -> None:
        """Write a control step: the command v [m/s], w [rad/s], shape (2,), the reward, and the next robot state."""
        self._write(self._topics.velocity, msg.Twist(*command.tolist()))
        self._step += 1
        self._messages.seq = self._step
        self._write_sensors(robot_state)
        self._write("/reward", self._make_scalar("std_msgs/Float64", reward))

    def _write_sensors(self, robot_state: RobotState) -> None:
        pose, odometry = robot_state.pose[0].tolist(), robot_state.odometry[0].tolist()
        twist, odometry_twist = robot_state.twist[0].tolist(), robot_state.odometry_twist[0].tolist()
        self._write("/clock", msg.Clock(self._now))
        _, odometry_origin = moved(np.array([odometry, (0.0, 0.0, 0.0)]), np.array(pose)).tolist()
        map_to_odom = self._make_transform(MAP, ODOM, *odometry_origin)
        self._write("/tf", msg.Transforms((map_to_odom, self._make_transform(ODOM, BASE, *odometry))))
        self._write("/ground_truth", msg.Odometry(self._now, MAP, BASE, pose, twist))
        odometry_message = msg.Odometry(self._now, ODOM, BASE, odometry, odometry_twist)
        self._write(self._topics.odometry, odometry_message, self._age)
        self._write(self._topics.scan, self._make_scan(robot_state.ranges[0]), self._age)
        bumped = bool(robot_state.bumped[0])
        self._write("/bumper", self._make_scalar("std_msgs/Bool", bumped))
        contact_angle = self._scene.laser.angles[np.argmin(robot_state.ranges[0])]
        before, self._pressed_bumper = self._pressed_bumper, bumper_at(contact_angle) if bumped else None
        for event in bumper_events(before, self._pressed_bumper):
            self._write(self._driver_topics.bumper, event)

    def _make_scan(self, task_ranges: np.ndarray) -> msg.LaserScan:
        """Make the scan of all beams of the laser from the ranges of the beams that the task uses."""
        laser, indices = replace(self._scene.laser, indices=None), self._scene.laser.indices
        ranges = np.full(len(laser.angles), math.nan)
        ranges[slice(None) if indices is None else list(indices)] = task_ranges
        return msg.LaserScan.of(laser, self._now, BASE, self._scene.task.control_period, ranges)

    def _make_transform(self, frame: str, child_frame: str, x: float, y: float, yaw: float) -> msg.Transform:
        return msg.Transform(self._now, frame, child_frame, (x, y, 0.0), msg.quaternion(yaw))

    @property
    def _now(self) -> int:  # [ns] of simulated time
        return round((START_TIME + self._step * self._scene.task.control_period) * msg.BILLION)

    def _make_scalar(self, type_name: str, value: float) -> Any:
        message = self._messages.make_message(type_name)
        message.data = value
        return message

    def _write(self, topic: str, message: Any, age: int = 0) -> None:
        self._writer.write(topic, message, self._now + age)


@contextmanager
def open_bag(path: Path, scene: Scene) -> Iterator[Recorder]:
    """Open a bag for an episode, see `tb2rl.deploy.bags.writing.open_writer`."""
    with open_writer(path) as writer:
        yield Recorder(writer, scene)
