"""Action spaces of tasks: named commands, or continuous velocities."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from contextlib import suppress
from copy import copy
from typing import Any, Self

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError, one_line
from tb2rl.robots import Robot

Command = tuple[float, float]  # v [m/s], w [rad/s]


class Actions(ABC):
    """An action space, and the command of each action.

    Attributes:
        space: Gymnasium's action space.
        names: Labels of actions in charts, maps and films, see `kinds`.
        table: v [m/s] and w [rad/s] of the named commands, or the lowest and highest velocities, shape (n, 2).
    """

    space: spaces.Space
    names: tuple[str, ...]
    table: np.ndarray

    @property
    def max_speed(self) -> float:
        """Largest absolute v of the commands [m/s]."""
        return float(np.abs(self.table[:, 0]).max())

    def clipped_to(self, robot: Robot) -> Self:
        """These actions, with `table` clipped to the robot's limits."""
        clipped = copy(self)
        clipped.table = robot.clip_commands(self.table)
        return clipped

    @abstractmethod
    def commands(self, actions: np.ndarray) -> np.ndarray:
        """Convert actions (num_envs, ...) to commands v [m/s] and w [rad/s], shape (num_envs, 2)."""

    @abstractmethod
    def kinds(self, actions: np.ndarray) -> np.ndarray:
        """Index of each action's kind in `names`, shape (num_envs,)."""

    @abstractmethod
    def checked(self, action: Any) -> np.ndarray:
        """Validate an action of one environment, and return it with a leading axis of length one.

        Raises:
            InputError: If the action is not in the action space; `Velocities` also accepts numbers beyond -1 and 1.
        """

    @abstractmethod
    def nearest(self, command: np.ndarray) -> Any:
        """The action whose command is nearest to v [m/s] and w [rad/s], shape (2,)."""

    def describe(self, action: Any) -> str:
        """A short text for one action, for films."""
        return self.names[int(self.kinds(np.asarray([action]))[0])]


class Commands(Actions):
    """Named commands: `Commands(forward=(0.5, 0.0), left=(0.05, 1.0))`.

    Actions are integers from 0, in the order of the names; `actions.left` is the action `left`.

    Args:
        commands: v [m/s] and w [rad/s] by name, at least one.

    Raises:
        InputError: If there is no command, a command is not two numbers, or a name is an attribute such as `space`.
    """

    space: spaces.Discrete

    def __init__(self, **commands: Command) -> None:
        if not commands:
            raise InputError("a task needs at least one action")
        self.names = tuple(commands)
        self.table = np.array([_pair(command, name, "v [m/s] and w [rad/s]") for name, command in commands.items()])
        self.space = spaces.Discrete(len(self.names))
        for index, name in enumerate(self.names):
            if hasattr(self, name):
                raise InputError(f"an action cannot have the name {name!r} of an attribute of Commands; rename it")
            setattr(self, name, index)

    def __getattr__(self, name: str) -> int:  # Python calls this only for missing attributes
        raise AttributeError(f"there is no action {name!r}; there are {', '.join(self.__dict__.get('names', ()))}")

    def plus(self, **commands: Command) -> Commands:
        """These commands, followed by others."""
        return Commands(**dict(zip(self.names, self.table.tolist(), strict=True)), **commands)

    def commands(self, actions: np.ndarray) -> np.ndarray:
        return self.table.take(actions, axis=0)

    def kinds(self, actions: np.ndarray) -> np.ndarray:
        return np.asarray(actions, dtype=np.int64)

    def checked(self, action: Any) -> np.ndarray:
        with suppress(TypeError):  # raised for a float, or an array with axes
            index = operator.index(action)
            if 0 <= index < len(self.names):
                return np.array([index])
        raise InputError(one_line(f"action {action!r} is not one of the integers 0 to {len(self.names) - 1}"))

    def nearest(self, command: np.ndarray) -> int:
        spans = np.maximum(np.abs(self.table).max(axis=0), 1e-9)
        return int(np.abs((self.table - command) / spans).sum(axis=1).argmin())


class Velocities(Actions):
    """Continuous velocities: an action is two numbers from -1 to 1, which span the ranges of speed and turn rate.

    Gaussian policies expect this scale (Stable-Baselines3, "Tips and Tricks when creating a custom environment").

    Args:
        forward: Range of v [m/s], the smaller number first.
        turn: Range of w [rad/s], the smaller number first.

    Raises:
        InputError: If a range is invalid.
    """

    space: spaces.Box
    names = ("stand", "forward", "backward", "left", "right")
    _THRESHOLD = 0.25  # share of the largest speed or turn rate; a smaller motion is named "stand"

    def __init__(self, forward: tuple[float, float], turn: tuple[float, float]) -> None:
        speeds = _pair(forward, "forward", "the slowest and the fastest [m/s]")
        self.table = np.column_stack([speeds, _pair(turn, "turn", "the least and the largest [rad/s]")])
        if (self.low > self.high).any():
            raise InputError(f"Velocities takes the smaller number first, got forward={forward}, turn={turn}")
        self.space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def low(self) -> np.ndarray:
        """Command of the action (-1, -1): v [m/s] and w [rad/s], shape (2,)."""
        return self.table[0]

    @property
    def high(self) -> np.ndarray:
        """Command of the action (1, 1): v [m/s] and w [rad/s], shape (2,)."""
        return self.table[1]

    def commands(self, actions: np.ndarray) -> np.ndarray:
        fractions = (np.clip(actions, -1.0, 1.0).astype(float) + 1.0) / 2.0
        return self.low + fractions * (self.high - self.low)

    def kinds(self, actions: np.ndarray) -> np.ndarray:
        (v, w), (min_v, min_w) = self.commands(np.asarray(actions)).T, self._THRESHOLD * np.abs(self.table).max(0)
        cases = {"left": w > min_w, "right": w < -min_w, "forward": v > min_v, "backward": v < -min_v}
        return np.select(list(cases.values()), [self.names.index(name) for name in cases], 0)

    def checked(self, action: Any) -> np.ndarray:
        values = np.asarray(action)
        if values.shape != (2,) or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            raise InputError(one_line(f"action {action!r} is not two numbers from -1 to 1"))
        return values[None].astype(float)

    def nearest(self, command: np.ndarray) -> np.ndarray:
        span = np.maximum(self.high - self.low, 1e-9)
        return np.clip(2.0 * (command - self.low) / span - 1.0, -1.0, 1.0).astype(np.float32)

    def describe(self, action: Any) -> str:
        return "{:.2f}, {:+.2f}".format(*self.commands(np.asarray([action]))[0])


def _pair(values: Any, name: str, meaning: str) -> np.ndarray:
    with suppress(TypeError, ValueError):
        pair = np.array(values, dtype=float)
        if pair.shape == (2,) and np.isfinite(pair).all():
            return pair
    raise InputError(one_line(f"action {name!r} needs two numbers, {meaning}, got {values!r}"))
