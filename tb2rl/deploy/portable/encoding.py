"""Encodes sensor data as the observation of the policy, exactly as the simulations of tb2rl do."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Callable, Dict, Mapping

import numpy as np

from .policy_contract import Needs, Point, SensorData, Speeds

_HISTORY_DURATION = 64.0  # [s] covered by the pose history


class Encoding:
    """Encodes sensor data as observations, with the frames of the last control steps stacked, the oldest first.

    `observation` is the entry of this name in `policy.json`.

    Attributes:
        sensor_data: The latest sensor data.
        acceleration: Mean forward acceleration since the last control step, from odometry [m/s^2].
        position_history: Positions x, y [m] of the last minute.
        history_period: Time between two positions of the history, about 1 [s].
        commands: The last commands, v [m/s] and w [rad/s], the newest first.
    """

    def __init__(self, observation: Mapping[str, Any], needs: Needs) -> None:
        self.needs, self._sensors = needs, observation["sensors"]
        self._is_discrete, self._frame_stack = observation["mode"] == "discrete", observation["frame_stack"]
        self._command_count = max(settings.get("command_history_length", 0) for settings in self._sensors)
        self._steps_per_position = max(1, round(1.0 / needs.period))
        self.history_period = self._steps_per_position * needs.period
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._frames: list[np.ndarray] = []
        self._step_count, self._speed = 0, 0.0
        self.position_history: deque[Point] = deque(maxlen=max(1, round(_HISTORY_DURATION / self.history_period)))
        self.commands: deque[Speeds] = deque(maxlen=self._command_count)

    def __call__(self, sensor_data: SensorData) -> np.ndarray:
        """The observation of this control step, shape (1, n): float32 numbers, or integer classes."""
        self.sensor_data = sensor_data
        self.acceleration, self._speed = (sensor_data.twist[0] - self._speed) / self.needs.period, sensor_data.twist[0]
        self.commands.extendleft([sensor_data.command] * (1 if self._step_count else self._command_count))
        if self._step_count % self._steps_per_position == 0:
            self.position_history.append(sensor_data.pose[:2])
        self._step_count += 1
        frame = np.concatenate([self._read(settings) for settings in self._sensors])
        self._frames = self._frames[1:] + [frame] if self._frames else [frame] * self._frame_stack
        return np.concatenate(self._frames)[None]

    def _read(self, settings: Mapping[str, Any]) -> np.ndarray:
        values = np.asarray(SENSORS[settings["name"]](self, settings), dtype=float)
        if self._is_discrete:
            return (values[:, None] >= np.array(settings["bins"])).sum(axis=1)
        return np.clip(values, np.float32(settings["low"]), np.float32(settings["high"])).astype(np.float32)

    def offset(self, point: Point | None) -> Point:
        """The vector from the robot to a point, both in the odometry frame [m]."""
        if point is None:
            raise ValueError("the policy needs a goal or a plan: set one first")
        return point[0] - self.sensor_data.pose[0], point[1] - self.sensor_data.pose[1]

    @property
    def goal_angle(self) -> float:
        """The direction of the goal relative to straight ahead, not wrapped [rad]."""
        dx, dy = self.offset(self.sensor_data.goal)
        return np.arctan2(dy, dx) - self.sensor_data.pose[2]

    @property
    def waypoint(self) -> Point:
        """The waypoint on the planned path in the robot's frame [m]."""
        dx, dy = self.offset(self.sensor_data.waypoint)
        cos, sin = np.cos(self.sensor_data.pose[2]), np.sin(self.sensor_data.pose[2])
        return cos * dx + sin * dy, cos * dy - sin * dx


def _free_paths(encoding: Encoding, settings: Mapping[str, Any]) -> np.ndarray:
    """The free path of a circle of the robot's size in each direction, up to a contact with a laser reading [m]."""
    ranges, radius = encoding.sensor_data.ranges, settings["radius"]
    angles = encoding.needs.beams - np.array(settings["directions"])[:, None]
    with np.errstate(invalid="ignore"):  # for infinite ranges
        lateral, cos = ranges * np.sin(angles), np.cos(angles)
        is_in_path = (np.abs(lateral) < radius) & (cos > 0.0)
        lengths = ranges * cos - np.sqrt(radius**2 - lateral**2)
    return np.where(is_in_path, np.maximum(lengths, 0.0), settings["high"]).min(axis=1, initial=settings["high"])


def _visited(encoding: Encoding, settings: Mapping[str, Any]) -> np.ndarray:
    """The time that the robot has spent near some points around it [s]."""
    (x, y, yaw), (ahead, left) = encoding.sensor_data.pose, np.array(settings["around"]).T
    cos, sin = np.cos(yaw), np.sin(yaw)
    points = np.column_stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left])
    offsets = np.array(encoding.position_history) - points[:, None]
    return encoding.history_period * (np.hypot(offsets[..., 0], offsets[..., 1]) < settings["near"]).sum(axis=1)


def _last_action(encoding: Encoding, settings: Mapping[str, Any]) -> np.ndarray:
    commands = np.array(encoding.commands)[: settings["command_history_length"]]
    return (commands / np.array(settings["max_speeds"])).ravel()


SENSORS: Dict[str, Callable[[Encoding, Mapping[str, Any]], Any]] = {
    "bumper": lambda encoding, settings: [encoding.sensor_data.bumped],
    "forward acceleration": lambda encoding, settings: [encoding.acceleration],
    "forward speed": lambda encoding, settings: encoding.sensor_data.twist[:1],
    "free paths": _free_paths,
    "goal bearing": lambda encoding, settings: [np.remainder(encoding.goal_angle + math.pi, math.tau) - math.pi],
    "goal direction": lambda encoding, settings: [np.cos(encoding.goal_angle), np.sin(encoding.goal_angle)],
    "goal distance": lambda encoding, settings: [np.hypot(*encoding.offset(encoding.sensor_data.goal))],
    "laser": lambda encoding, settings: encoding.sensor_data.ranges,
    "last action": _last_action,
    "turn rate": lambda encoding, settings: encoding.sensor_data.twist[1:],
    "visited": _visited,
    "waypoint": lambda encoding, settings: encoding.waypoint,
    "waypoint bearing": lambda encoding, settings: [np.arctan2(*encoding.waypoint[::-1])],
    "yaw rate": lambda encoding, settings: encoding.sensor_data.twist[1:],  # in place of a gyro, if wheels slip little
}
