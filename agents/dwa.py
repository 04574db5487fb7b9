"""The dynamic window approach (Fox, Burgard & Thrun 1997, "The dynamic window approach to collision avoidance")."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from tb2rl import Agent
from tb2rl.agents._local_planner import TURTLEBOT2, LocalPlanner, LocalView, free_distance, rotation_side
from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.core.values import NonNegative, Positive
from tb2rl.robots.vehicle import Vehicle

AGENT = Agent(algorithm=None, policy="tb2rl.agents.dwa:DWA", observation="raw", only=True)

SPEEDS, TURNS = 4, 15  # samples of both windows, with their ends and the middle of turns
_SOON = 0.4  # [s] time of the heading that counts
_CLEAR = 1.0  # [m] longer free distances count alike


class _Limits(NamedTuple):
    """Limits of the robot, in metres, seconds and radians; see `DWA`."""

    max_speed: float
    turn_rate: float
    acceleration: float
    turn_acceleration: float
    period: float
    horizon: float
    radius: float
    gap: float


class _Weights(NamedTuple):
    """Weights of the objective's parts, which lie between 0 and 1 (progress: -1 and 1)."""

    heading: float
    clearance: float
    speed: float
    progress: float


class DWA(LocalPlanner):
    """Takes the best safe pair of the speeds that the motors reach within a control period.

    A pair (v, w) is safe if the robot can stop on its free arc. The best one has the largest weighted sum of heading
    (to the target, soon), clearance (of its arc), speed, and progress (towards the target within `horizon`). The first
    three are the paper's, the last is that of ROS's `dwa_local_planner`. A stuck robot rotates away, as in the paper.

    Args:
        observation_space, action_space, vehicle: See `LocalPlanner`.
        gap: Distance to keep from obstacles [m].
        acceleration: Of v, also for braking [m/s^2].
        turn_acceleration: Of w [rad/s^2].
        horizon: Time over which progress counts [s].
        heading, clearance, speed, progress: Weights.
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        vehicle: Vehicle = TURTLEBOT2,
        gap: NonNegative = 0.04,
        acceleration: Positive = 1.0,
        turn_acceleration: Positive = 6.0,
        horizon: Positive = 1.0,
        heading: NonNegative = 1.0,
        clearance: NonNegative = 0.5,
        speed: NonNegative = 0.5,
        progress: NonNegative = 1.0,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, vehicle, **kwargs)
        speeds = self.max_speed, self.turn_rate, acceleration, turn_acceleration
        self._limits = _Limits(*speeds, self.period, horizon, self.radius, gap)
        self._weights = _Weights(heading, clearance, speed, progress)

    def plan(self, view: LocalView) -> np.ndarray:
        commands = np.zeros((len(view.speed), 2))
        _choose(view.points, view.target, view.speed, view.turn, self._limits, self._weights, commands)
        return commands


@njit(cache=True, **UNCOUNTED)
def _choose(points, targets, speeds, turns, limits, weights, commands):
    """Write the best speeds into `commands`, zeros of shape (num_envs, 2); the first four are those of `LocalView`."""
    for robot in range(points.shape[0]):
        side = rotation_side(points[robot], targets[robot], speeds[robot], turns[robot], limits.radius, limits.gap)
        if side:
            commands[robot, 1] = side * limits.turn_rate
            continue
        slowest, max_speed = _window(speeds[robot], limits.acceleration * limits.period, 0.0, limits.max_speed)
        turn_change = limits.turn_acceleration * limits.period
        right, left = _window(turns[robot], turn_change, -limits.turn_rate, limits.turn_rate)
        best = -math.inf
        for i in range(SPEEDS):
            v = slowest + (max_speed - slowest) * i / (SPEEDS - 1)
            for j in range(TURNS):
                w = right + (left - right) * j / (TURNS - 1)
                value = _value(points[robot], targets[robot], v, w, limits, weights)
                if value > best:
                    best, commands[robot, 0], commands[robot, 1] = value, v, w


@njit(cache=True, **UNCOUNTED)
def _window(now, change, low, high):
    """The lowest and highest reachable speed."""
    return min(max(now - change, low), high), max(min(now + change, high), low)


@njit(cache=True, **UNCOUNTED)
def _value(points, target, v, w, limits, weights):
    """The objective of speeds v, w for one robot; -inf: it could not stop in time."""
    free = math.inf
    if v > 1e-3:
        enough = max(_CLEAR, limits.max_speed * limits.horizon)
        free = free_distance(points, w / v, limits.radius, limits.gap, enough)
        if v * limits.period + v * v / (2.0 * limits.acceleration) > free:
            return -math.inf
    x, y = _after(v, w, _SOON)
    off = math.atan2(target[1] - y, target[0] - x) - w * _SOON
    heading = 1.0 - abs((off + math.pi) % math.tau - math.pi) / math.pi
    x, y = _after(v, w, min(limits.horizon, free / max(v, 1e-3)))
    closer = math.hypot(target[0], target[1]) - math.hypot(target[0] - x, target[1] - y)
    return (
        weights.heading * heading
        + weights.clearance * min(free / _CLEAR, 1.0)
        + weights.speed * v / limits.max_speed
        + weights.progress * closer / (limits.max_speed * limits.horizon)
    )


@njit(cache=True, **UNCOUNTED)
def _after(v, w, seconds):
    """The position after driving at constant speeds, x and y in the present frame [m]."""
    if abs(w) < 1e-3:
        return v * seconds, 0.0
    return v / w * math.sin(w * seconds), v / w * (1.0 - math.cos(w * seconds))
