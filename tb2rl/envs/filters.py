"""Filters: changes of velocity commands on their way from the action to the robot.

This file needs only Python 3.8 and numpy, and imports nothing of tb2rl, because exported policies include it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np


class SensedState(NamedTuple):
    """The latest readings of the robots' sensors, which are `age` old.

    Attributes:
        ranges: Laser ranges [m], right to left, inf without a hit, shape (num_envs, beams).
        pose: x [m], y [m], yaw [rad] by the odometry, shape (num_envs, 3).
        twist: v [m/s] and w [rad/s] by the odometry, shape (num_envs, 2).
        bumped: Whether the bumper is pressed, shape (num_envs,).
        command: The latest command in effect, v [m/s] and w [rad/s], shape (num_envs, 2).
        age: Time since the ranges and the odometry were measured [s], shape (num_envs,).
    """

    ranges: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    bumped: np.ndarray
    command: np.ndarray
    age: np.ndarray


class Filter:
    """A filter of velocity commands; this base class changes nothing.

    Filters run in order, once per control step, in simulation and on robots. A filter with a memory also overrides
    `reset`, `reset_at`, `state` and `restore`.

    Attributes:
        acts_in_training: Whether it also acts while a policy learns.
    """

    acts_in_training = True

    def reset(self, num_envs: int) -> None:
        """Start a new episode in each environment."""

    def reset_at(self, indices: np.ndarray) -> None:
        """Start a new episode in the environments with these indices."""

    def __call__(self, commands: np.ndarray, robot_state: SensedState) -> np.ndarray:
        """Filter the commands of one control step.

        Args:
            commands: v [m/s] and w [rad/s], shape (num_envs, 2).
            robot_state: What the robots sense before the step.

        Returns:
            A new array of the same shape, or `commands` itself.
        """
        return commands

    def reason(self, index: int) -> str:
        """Why the filter changed the latest command in an environment, for users; empty if it has nothing to say."""
        return ""

    def state(self) -> dict[str, np.ndarray]:
        """The memory of the filter: arrays by name, each with num_envs rows."""
        return {}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continue from a result of `state`."""


def intervention(filters: Iterable[Filter], index: int) -> str:
    """The first reason of the filters for a change of the latest command in an environment, or an empty string."""
    return next(filter(None, (each.reason(index) for each in filters)), "")


class SpeedLimits(Filter):
    """Scales commands down to speed limits; the robot stays on the same arc.

    Args:
        speed: Largest absolute v [m/s], above 0; the default is no limit.
        turn_rate: Largest absolute w [rad/s], above 0; the default is no limit.

    Raises:
        ValueError: If a limit is not above 0.
    """

    def __init__(self, speed: float = math.inf, turn_rate: float = math.inf) -> None:
        for name, value, unit in (("speed", speed, "m/s"), ("turn_rate", turn_rate, "rad/s")):
            if not value > 0.0:  # also true for NaN
                raise ValueError(f"{name} must be above 0 {unit}, got {value}")
        self.speed, self.turn_rate = speed, turn_rate

    def __call__(self, commands: np.ndarray, robot_state: Any = None) -> np.ndarray:
        """Scale commands down, see `Filter.__call__`."""
        limits = np.array([self.speed, self.turn_rate])
        scale = np.minimum(1.0, (limits / np.maximum(np.abs(commands), 1e-9)).min(axis=1, keepdims=True))
        return np.clip(scale * commands, -limits, limits)  # rounding can push the product above a limit
