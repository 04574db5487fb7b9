"""Filters change velocity commands between the action and the robot.

This file needs Python 3.8 and numpy only and imports nothing of tb2rl, because exported policies take it to robots.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np


class Filter:
    """A step between the command of an action and the robot; this base class changes nothing.

    Filters run in order, once a control step, in simulation and on robots. A filter that remembers something overrides
    `reset`, `reset_at`, `state` and `restore` too.
    """

    def reset(self, num_envs: int) -> None:
        """Start a new episode in each environment."""

    def reset_at(self, indices: np.ndarray) -> None:
        """Start a new episode in the environments with these indices."""

    def __call__(self, commands: np.ndarray, robot_state: Any) -> np.ndarray:
        """Filter the commands of one control step.

        Args:
            commands: v [m/s] and w [rad/s], shape (num_envs, 2).
            robot_state: The state that the commands answer to: `ranges` [m], shape (num_envs, beams), right to left and
                inf where nothing was hit; `pose` (num_envs, 3); `twist` and last `command` (num_envs, 2); `bumped`
                (num_envs,).

        Returns:
            A new array of the same shape, or `commands` itself.
        """
        return commands

    def state(self) -> dict[str, np.ndarray]:
        """The memory of the filter, by name; each array has num_envs rows."""
        return {}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continue from what `state` returned."""


class SpeedLimits(Filter):
    """Slows commands down to the limits of a robot; the robot stays on the same arc.

    Args:
        speed: Largest |v| [m/s], above 0; inf: no limit.
        turn_rate: Largest |w| [rad/s], above 0; inf: no limit.

    Raises:
        ValueError: If a limit is not above 0.
    """

    def __init__(self, speed: float = math.inf, turn_rate: float = math.inf) -> None:
        for name, value, unit in (("speed", speed, "m/s"), ("turn_rate", turn_rate, "rad/s")):
            if not value > 0.0:  # NaN is not, either
                raise ValueError(f"{name} takes {unit} above 0, got {value}")
        self.speed, self.turn_rate = speed, turn_rate

    def __call__(self, commands: np.ndarray, robot_state: Any = None) -> np.ndarray:
        """Slow commands down, see `Filter`."""
        limits = np.array([self.speed, self.turn_rate])
        scale = np.minimum(1.0, (limits / np.maximum(np.abs(commands), 1e-9)).min(axis=1, keepdims=True))
        return np.clip(scale * commands, -limits, limits)  # the product can exceed a limit by its rounding


class CommandDelay(Filter):
    """Delays commands by the latency of each environment's robot; in simulation only, because a robot has its own.

    Args:
        max_latency: The largest latency [control steps].
    """

    def __init__(self, max_latency: int) -> None:
        self.max_latency = max_latency

    def reset(self, num_envs: int) -> None:
        self._queue = np.zeros((num_envs, self.max_latency + 1, 2))  # the newest first

    def reset_at(self, indices: np.ndarray) -> None:
        self._queue[indices] = 0.0

    def __call__(self, commands: np.ndarray, robot_state: Any) -> np.ndarray:
        if not self.max_latency:
            return commands
        self._queue = np.concatenate([commands[:, None], self._queue[:, :-1]], axis=1)
        latency = robot_state.initial_state.command_latency.astype(int)  # [control steps]
        return self._queue[np.arange(len(self._queue)), latency]

    def state(self) -> dict[str, np.ndarray]:
        return {"queue": self._queue.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self._queue = np.array(state["queue"])
