"""Encodes sensor data as the observation of the policy; the same numbers as in tb2rl's simulations."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Callable, Dict, Mapping

import numpy as np

from .policy_contract import Needs, Point, SensorData

_KEPT = 64.0  # [s] of the pose history


class Encoding:
    """Turns sensor data into observations, the last few control steps side by side, the oldest first.

    Args:
        observation: The entry "observation" of `policy.json`.
        needs: The requirements of the policy.

    Attributes:
        sensed: The latest sensor data.
        acceleration: Forward since the last control step, by the odometry [m/s^2].
        pose_history: x and y [m] in the last minute, about once a second.
        history_period: From one of these places to the next [s].
        commands: The last commands, v [m/s] and w [rad/s], the newest first.

    Raises:
        ValueError: If there is an unknown sensor.
    """

    def __init__(self, observation: Mapping[str, Any], needs: Needs) -> None:
        self._sensors = observation["sensors"]
        for settings in self._sensors:
            if settings["name"] not in SENSORS:
                raise ValueError(f"this program does not know the sensor {settings['name']}")
        self._command_count = max(settings.get("reads_commands", 0) for settings in self._sensors)
        self._discrete, self._frame_stack = observation["mode"] == "discrete", observation["frame_stack"]
        self.needs = needs
        self._history_steps = max(1, round(1.0 / needs.period))
        self.history_period = self._history_steps * needs.period
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._frames: list[np.ndarray] = []
        self._speed = self.acceleration = 0.0
        self.pose_history: deque[Point] = deque(maxlen=max(1, round(_KEPT / self.history_period)))
        self._steps = 0
        self.commands: deque[Point] = deque(maxlen=self._command_count)

    def __call__(self, sensed: SensorData) -> np.ndarray:
        """The observation of this control step, shape (1, n): float32 numbers, or integer classes."""
        self.sensed = sensed
        self.acceleration, self._speed = (sensed.twist[0] - self._speed) / self.needs.period, sensed.twist[0]
        self.commands.extendleft([sensed.command] * (1 if self._steps else self._command_count))
        if self._steps % self._history_steps == 0:
            self.pose_history.append(sensed.pose[:2])
        self._steps += 1
        frame = np.concatenate([self._read(settings) for settings in self._sensors])
        self._frames = self._frames[1:] + [frame] if self._frames else [frame] * self._frame_stack
        return np.concatenate(self._frames)[None]

    def _read(self, settings: Mapping[str, Any]) -> np.ndarray:
        values = np.asarray(SENSORS[settings["name"]](self, settings), dtype=float)
        if self._discrete:
            return (values[:, None] >= np.array(settings["bins"])).sum(axis=1)
        return np.clip(values, np.float32(settings["low"]), np.float32(settings["high"])).astype(np.float32)

    def offset(self, point: Point | None) -> Point:
        """A point of the odometry frame relative to the robot, along the axes of that frame [m]."""
        if point is None:
            raise ValueError("this policy needs a goal or a point of a plan, and there is none")
        return point[0] - self.sensed.pose[0], point[1] - self.sensed.pose[1]

    @property
    def goal_angle(self) -> float:
        """The direction of the goal, counted from straight ahead [rad], plus any number of turns."""
        east, north = self.offset(self.sensed.goal)
        return np.arctan2(north, east) - self.sensed.pose[2]

    @property
    def waypoint(self) -> Point:
        """The point on the planned path in the robot's frame [m]."""
        east, north = self.offset(self.sensed.waypoint)
        cos, sin = np.cos(self.sensed.pose[2]), np.sin(self.sensed.pose[2])
        return cos * east + sin * north, cos * north - sin * east


def _free_paths(encoding: Encoding, settings: Mapping[str, Any]) -> np.ndarray:
    """How far a circle of the robot's size can move in each direction before it touches a point hit by a beam [m]."""
    ranges, radius = encoding.sensed.ranges, settings["radius"]
    between = encoding.needs.beams - np.array(settings["directions"])[:, None]
    with np.errstate(invalid="ignore"):  # of beams that hit nothing
        beside, ahead = ranges * np.sin(between), np.cos(between)
        touches = (np.abs(beside) < radius) & (ahead > 0.0)
        before = ranges * ahead - np.sqrt(radius**2 - beside**2)
    return np.where(touches, np.maximum(before, 0.0), settings["high"]).min(axis=1, initial=settings["high"])


def _visited(encoding: Encoding, settings: Mapping[str, Any]) -> np.ndarray:
    """How long the robot has been at some places around it [s]."""
    (x, y, yaw), (ahead, left) = encoding.sensed.pose, np.array(settings["around"]).T
    cos, sin = np.cos(yaw), np.sin(yaw)
    places = np.column_stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left])
    away = np.array(encoding.pose_history) - places[:, None]
    return encoding.history_period * (np.hypot(away[..., 0], away[..., 1]) < settings["near"]).sum(axis=1)


def _last_action(encoding: Encoding, settings: Mapping[str, Any]) -> np.ndarray:
    commands = [encoding.commands[k] for k in range(settings["reads_commands"])]
    return (np.array(commands) / np.array(settings["max_speeds"])).ravel()


SENSORS: Dict[str, Callable[[Encoding, Mapping[str, Any]], Any]] = {
    "bumper": lambda encoding, settings: [encoding.sensed.bumped],
    "forward acceleration": lambda encoding, settings: [encoding.acceleration],
    "forward speed": lambda encoding, settings: encoding.sensed.twist[:1],
    "free paths": _free_paths,
    "goal bearing": lambda encoding, settings: [np.remainder(encoding.goal_angle + math.pi, math.tau) - math.pi],
    "goal direction": lambda encoding, settings: [np.cos(encoding.goal_angle), np.sin(encoding.goal_angle)],
    "goal distance": lambda encoding, settings: [np.hypot(*encoding.offset(encoding.sensed.goal))],
    "laser": lambda encoding, settings: encoding.sensed.ranges,
    "last action": _last_action,
    "turn rate": lambda encoding, settings: encoding.sensed.twist[1:],
    "visited": _visited,
    "waypoint": lambda encoding, settings: encoding.waypoint,
    "waypoint bearing": lambda encoding, settings: [np.arctan2(*encoding.waypoint[::-1])],
    "yaw rate": lambda encoding, settings: encoding.sensed.twist[1:],  # by the wheels: they hardly slip
}
