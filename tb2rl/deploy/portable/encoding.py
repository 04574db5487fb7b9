"""From what a robot senses to what its policy was trained to observe; the same numbers as in tb2rl's simulations."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Callable, Deque, Dict, List, Mapping, Tuple

import numpy as np

from .policy_contract import Needs, Point, Sensed

Settings = Mapping[str, Any]  # of a sensor, in `policy.json`
_KEPT = 64.0  # [s] of the trail


class Encoding:
    """What a policy observes, the last few control steps side by side, the oldest first.

    Args:
        observation: What `policy.json` says of it.
        needs: What the policy needs.

    Attributes:
        needs: The same.
        acceleration: Ahead since the last control step, by the odometry [m/s^2].
        pose_history: Where it was in the last minute, x and y [m], about once a second.
        trail_period: From one of these places to the next [s].
        told: The last commands, v [m/s] and w [rad/s], the newest first.

    Raises:
        ValueError: If there is a sensor that is not known here.
    """

    def __init__(self, observation: Mapping[str, Any], needs: Needs) -> None:
        self._sensors: List[Tuple[Settings, Callable[..., np.ndarray]]] = []
        for settings in observation["sensors"]:
            if settings["name"] not in _SENSORS:
                raise ValueError("this runner does not know the sensor {}".format(settings["name"]))
            self._sensors.append((settings, _SENSORS[settings["name"]]))
        self._told = max(settings.get("reads_commands", 0) for settings, _ in self._sensors)
        self._as_classes, self._frame_stack = observation["mode"] == "discrete", observation["frame_stack"]
        self.needs = needs
        self._every = max(1, round(1.0 / needs.period))
        self.trail_period = self._every * needs.period
        self.begin()

    def begin(self) -> None:
        """Forget what was observed: an episode begins."""
        self._past: List[np.ndarray] = []
        self._speed = self.acceleration = 0.0
        self.pose_history: Deque[Point] = deque(maxlen=max(1, round(_KEPT / self.trail_period)))
        self._steps = 0
        self.told: Deque[Point] = deque(maxlen=self._told)

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """What the policy observes now, shape (1, n): float32 numbers, or the numbers of classes."""
        self.acceleration, self._speed = (sensed.twist[0] - self._speed) / self.needs.period, sensed.twist[0]
        self.told.extendleft([sensed.command] * (1 if self._steps else self._told))
        if self._steps % self._every == 0:
            self.pose_history.append(sensed.pose[:2])
        self._steps += 1
        parts = [self._encoded(read(sensed, settings, self), settings) for settings, read in self._sensors]
        latest = np.concatenate(parts)
        self._past = self._past[1:] + [latest] if self._past else [latest] * self._frame_stack
        return np.concatenate(self._past)[None]

    def _encoded(self, values: np.ndarray, settings: Settings) -> np.ndarray:
        if self._as_classes:
            return (values[:, None] >= np.array(settings["bins"])).sum(axis=1)
        return np.clip(values, np.float32(settings["low"]), np.float32(settings["high"])).astype(np.float32)


def _to(point: Point, sensed: Sensed) -> Tuple[float, float]:
    """How far a point of the odometry frame is from the robot, along that frame's axes [m]."""
    return point[0] - sensed.pose[0], point[1] - sensed.pose[1]


def _goal(sensed: Sensed) -> Tuple[float, float]:
    if sensed.goal is None:
        raise ValueError("this policy drives to a goal, and it was told none")
    return _to(sensed.goal, sensed)


def _goal_distance(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    return np.array([np.hypot(*_goal(sensed))])


def _goal_angle(sensed: Sensed) -> float:
    east, north = _goal(sensed)
    return np.arctan2(north, east) - sensed.pose[2]


def _goal_bearing(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    return np.array([np.remainder(_goal_angle(sensed) + math.pi, math.tau) - math.pi])


def _goal_direction(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    angle = _goal_angle(sensed)
    return np.array([np.cos(angle), np.sin(angle)])


def _waypoint(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    if sensed.waypoint is None:
        raise ValueError("this policy follows a planned way, and it was told no point of one")
    east, north = _to(sensed.waypoint, sensed)
    cos, sin = np.cos(sensed.pose[2]), np.sin(sensed.pose[2])
    return np.array([cos * east + sin * north, cos * north - sin * east])


def _waypoint_bearing(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    ahead, left = _waypoint(sensed, settings, encoding)
    return np.array([np.arctan2(left, ahead)])


def _free_paths(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    """How far a circle as wide as the robot gets in each direction until it touches what a beam has hit."""
    radius, between = settings["radius"], encoding.needs.beams - np.array(settings["directions"])[:, None]
    with np.errstate(invalid="ignore"):  # of beams that hit nothing
        beside, ahead = sensed.ranges * np.sin(between), np.cos(between)
        touches = (np.abs(beside) < radius) & (ahead > 0.0)
        before = sensed.ranges * ahead - np.sqrt(radius**2 - beside**2)
    return np.where(touches, np.maximum(before, 0.0), settings["high"]).min(axis=1, initial=settings["high"])


def _visited(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    """How long it has been at some places around it [s]."""
    (x, y, yaw), (ahead, left) = sensed.pose, np.array(settings["around"]).T
    cos, sin = np.cos(yaw), np.sin(yaw)
    places = np.column_stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left])
    away = np.array(encoding.pose_history) - places[:, None]
    return encoding.trail_period * (np.hypot(away[..., 0], away[..., 1]) < settings["near"]).sum(axis=1)


def _last_action(sensed: Sensed, settings: Settings, encoding: Encoding) -> np.ndarray:
    told = [encoding.told[k] for k in range(settings["reads_commands"])]
    return (np.array(told) / np.array(settings["max_speeds"])).ravel()


_SENSORS: Dict[str, Callable[[Sensed, Settings, Encoding], np.ndarray]] = {
    "bumper": lambda sensed, settings, encoding: np.array([float(sensed.bumped)]),
    "forward acceleration": lambda sensed, settings, encoding: np.array([encoding.acceleration]),
    "forward speed": lambda sensed, settings, encoding: np.array(sensed.twist[:1]),
    "free paths": _free_paths,
    "goal bearing": _goal_bearing,
    "goal direction": _goal_direction,
    "goal distance": _goal_distance,
    "laser": lambda sensed, settings, encoding: np.asarray(sensed.ranges, dtype=float),
    "last action": _last_action,
    "turn rate": lambda sensed, settings, encoding: np.array(sensed.twist[1:]),
    "visited": _visited,
    "waypoint": _waypoint,
    "waypoint bearing": _waypoint_bearing,
    "yaw rate": lambda sensed, settings, encoding: np.array(sensed.twist[1:]),  # by the wheels: they hardly slip
}
