"""The dynamic window approach (Fox, Burgard & Thrun 1997, "The dynamic window approach to collision avoidance")."""

import math
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from tb2rl import Agent
from tb2rl.agents._local_planner import TURTLEBOT2, LocalPlanner, LocalView, free_distance, rotation_side
from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.core.values import NonNegative, Positive
from tb2rl.robots.vehicle import Vehicle

AGENT = Agent(algorithm=None, policy="tb2rl.agents.dwa:DWA", fixed_obs_mode=True)

NUM_SPEEDS, NUM_TURN_RATES = 4, 15  # samples of v and w, including both ends; w also includes the middle
_HEADING_TIME = 0.4  # [s] the heading is evaluated after driving for this time
_MAX_CLEARANCE = 1.0  # [m] longer free distances do not increase the objective


class _Limits(NamedTuple):
    """Limits of the robot and of the search, in metres, seconds and radians; see `DWA`."""

    max_speed: float
    max_turn_rate: float
    acceleration: float
    turn_acceleration: float
    period: float
    horizon: float
    radius: float
    gap: float


class _Weights(NamedTuple):
    """Weights of the terms of the objective. Terms are between 0 and 1, progress between -1 and 1."""

    heading: float
    clearance: float
    speed: float
    progress: float


class DWA(LocalPlanner):
    """Selects the best safe pair (v, w) of the speeds that the motors can reach within a control period.

    A pair is safe if the robot can stop before its arc touches an obstacle. The objective is a weighted sum of heading
    (to the target, 0.4 s later), clearance (free distance along the arc), speed, and progress (towards the target
    within `horizon`). Progress is a term of ROS's `dwa_local_planner`; the other terms are the paper's. A blocked robot
    rotates away, as in the paper.

    Args:
        observation_space, action_space, vehicle: See `LocalPlanner`.
        gap: Distance to keep from obstacles [m].
        acceleration: Largest change of v, also when braking [m/s^2].
        turn_acceleration: Largest change of w [rad/s^2].
        horizon: Driving time after which progress is measured [s].
        heading: Weight of the direction to the target.
        clearance: Weight of the distance to obstacles.
        speed: Weight of the forward speed.
        progress: Weight of the progress towards the target.
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
        dynamics = vehicle.max_speed, vehicle.max_turn_rate, acceleration, turn_acceleration
        self._limits = _Limits(*dynamics, vehicle.period, horizon, vehicle.radius, gap)
        self._weights = _Weights(heading, clearance, speed, progress)

    def plan(self, view: LocalView) -> np.ndarray:
        commands = np.zeros((len(view.speed), 2))
        _choose_commands(view, self._limits, self._weights, commands)
        return commands


@njit(cache=True, **NO_REFCOUNT)
def _choose_commands(view, limits, weights, commands):
    """Replace zeros in `commands`, shape (num_envs, 2), by the best safe v, w, if any; a blocked robot rotates away."""
    for robot in range(commands.shape[0]):
        side = rotation_side(view, robot, limits.radius, limits.gap)
        if side:
            commands[robot, 1] = side * limits.max_turn_rate
            continue
        low, high = _reachable_range(view.speed[robot], limits.acceleration * limits.period, 0.0, limits.max_speed)
        turn_change = limits.turn_acceleration * limits.period
        right, left = _reachable_range(view.turn_rate[robot], turn_change, -limits.max_turn_rate, limits.max_turn_rate)
        best = -math.inf
        for i in range(NUM_SPEEDS):
            v = low + (high - low) * i / (NUM_SPEEDS - 1)
            for j in range(NUM_TURN_RATES):
                w = right + (left - right) * j / (NUM_TURN_RATES - 1)
                value = _objective(view.points[robot], view.target[robot], v, w, limits, weights)
                if value > best:
                    best, commands[robot, 0], commands[robot, 1] = value, v, w


@njit(cache=True, **NO_REFCOUNT)
def _reachable_range(current, change, low, high):
    """The lowest and the highest speed that the motors can reach within a control period."""
    return min(max(current - change, low), high), max(min(current + change, high), low)


@njit(cache=True, **NO_REFCOUNT)
def _objective(points, target, v, w, limits, weights):
    """The objective of v, w for one robot; -inf if the robot could not stop in time."""
    free = math.inf
    if v > 1e-3:
        max_distance = max(_MAX_CLEARANCE, limits.max_speed * limits.horizon)
        free = free_distance(points, w / v, limits.radius, limits.gap, max_distance)
        if v * limits.period + v * v / (2.0 * limits.acceleration) > free:
            return -math.inf
    x, y = _position_after(v, w, _HEADING_TIME)
    error = math.atan2(target[1] - y, target[0] - x) - w * _HEADING_TIME
    heading = 1.0 - abs((error + math.pi) % math.tau - math.pi) / math.pi
    x, y = _position_after(v, w, min(limits.horizon, free / max(v, 1e-3)))
    progress = math.hypot(target[0], target[1]) - math.hypot(target[0] - x, target[1] - y)
    return (
        weights.heading * heading
        + weights.clearance * min(free / _MAX_CLEARANCE, 1.0)
        + weights.speed * v / limits.max_speed
        + weights.progress * progress / (limits.max_speed * limits.horizon)
    )


@njit(cache=True, **NO_REFCOUNT)
def _position_after(v, w, seconds):
    """The position x, y after driving at constant speeds, in the frame of the robot's present pose [m]."""
    if abs(w) < 1e-3:
        return v * seconds, 0.0
    return v / w * math.sin(w * seconds), v / w * (1.0 - math.cos(w * seconds))
