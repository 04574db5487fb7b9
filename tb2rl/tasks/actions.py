"""What a robot can be told to do: named commands, or any speeds within a range."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from copy import copy
from typing import Any, Self

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError, one_line
from tb2rl.robots import Robot

Command = tuple[float, float]  # v [m/s], w [rad/s]


class Actions(ABC):
    """The actions of a task, and what each of them tells the base.

    Attributes:
        space: What an action is, for Gymnasium.
        names: Names for kinds of actions, for people: in charts, maps and films.
    """

    space: spaces.Space
    names: tuple[str, ...]

    @property
    @abstractmethod
    def max_speed(self) -> float:
        """The largest speed |v| that an action commands [m/s]."""

    @abstractmethod
    def commands(self, actions: np.ndarray) -> np.ndarray:
        """What actions tell the base: v [m/s] and w [rad/s], (num_envs, ...) to (num_envs, 2)."""

    @abstractmethod
    def within(self, robot: Robot) -> Self:
        """These actions, without what a robot cannot do."""

    @abstractmethod
    def kinds(self, actions: np.ndarray) -> np.ndarray:
        """Which of the `names` each action is, as an index, shape (num_envs,)."""

    @abstractmethod
    def checked(self, action: Any) -> np.ndarray:
        """One action of a user as an array with a robot axis of length one.

        Raises:
            InputError: If it is not an action.
        """

    @abstractmethod
    def nearest(self, command: np.ndarray) -> Any:
        """The action that is most like a command v [m/s], w [rad/s], shape (2,)."""

    def describe(self, action: Any) -> str:
        """One action in a few letters, for a film."""
        return self.names[int(self.kinds(np.asarray([action]))[0])]


class Commands(Actions):
    """Named commands, each held for a control period: `Commands(forward=(0.5, 0.0), left=(0.05, 1.0))`.

    An action is a number from 0, in the order of the names; `actions.left` is the number of `left`.

    Args:
        commands: v [m/s] and w [rad/s] by name, at least one.

    Raises:
        InputError: If there is none of them, one is not two numbers, or a name is not free, such as `space`.
    """

    space: spaces.Discrete

    def __init__(self, **commands: Command) -> None:
        if not commands:
            raise InputError("a task needs at least one action")
        self.names = tuple(commands)
        self.table = np.array([_pair(command, name, "v [m/s] and w [rad/s]") for name, command in commands.items()])
        self.space = spaces.Discrete(len(self.names))
        taken = [name for name in self.names if hasattr(self, name)]
        if taken:
            raise InputError(f"an action cannot be called {taken[0]!r}, which means something else here")
        self.__dict__.update({name: number for number, name in enumerate(self.names)})

    def __getattr__(self, name: str) -> int:  # for what is not an attribute
        raise AttributeError(f"there is no action {name!r}; there are {', '.join(self.__dict__.get('names', ()))}")

    def plus(self, **commands: Command) -> Commands:
        """These commands and more."""
        present: dict[str, Command] = {name: (v, w) for name, (v, w) in zip(self.names, self.table, strict=True)}
        return Commands(**present, **commands)

    def within(self, robot: Robot) -> Self:
        cut = copy(self)
        cut.table = robot.within_limits(self.table)
        return cut

    @property
    def max_speed(self) -> float:
        return float(np.abs(self.table[:, 0]).max())

    def commands(self, actions: np.ndarray) -> np.ndarray:
        return self.table.take(actions, axis=0)

    def kinds(self, actions: np.ndarray) -> np.ndarray:
        return np.asarray(actions, dtype=np.int64)

    def checked(self, action: Any) -> np.ndarray:
        try:
            index = operator.index(action)
        except TypeError:  # a float, NaN, a longer array
            index = -1
        if not 0 <= index < len(self.names):
            raise InputError(one_line(f"action {action!r} is not one of the integers 0 to {len(self.names) - 1}"))
        return np.array([index])

    def nearest(self, command: np.ndarray) -> int:
        spans = np.maximum(np.abs(self.table).max(axis=0), 1e-9)
        return int(np.abs((self.table - command) / spans).sum(axis=1).argmin())


class Velocities(Actions):
    """Any forward speed and turn rate within a range; an action is two numbers from -1 to 1, the ends of the ranges.

    Learners with Gaussian policies expect that scale (Stable-Baselines3, "Tips and Tricks when creating a custom
    environment").

    Args:
        forward: Slowest and fastest v [m/s].
        turn: Least and largest w [rad/s].

    Raises:
        InputError: If one is not two numbers, the smaller one first.
    """

    space: spaces.Box
    names = ("stand", "forward", "backward", "left", "right")
    _BARELY = 0.25  # of the largest speed or turn rate: below this it does not count as going or turning

    def __init__(self, forward: tuple[float, float], turn: tuple[float, float]) -> None:
        ranges = [_pair(forward, "forward", "the slowest and the fastest [m/s]")]
        ranges.append(_pair(turn, "turn", "the least and the largest [rad/s]"))
        self.low, self.high = np.array(ranges).T
        if (self.low > self.high).any():
            raise InputError(f"Velocities takes the smaller number first, got forward={forward}, turn={turn}")
        self.space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def within(self, robot: Robot) -> Self:
        cut = copy(self)
        cut.low, cut.high = robot.within_limits(np.array([self.low, self.high]))
        return cut

    @property
    def max_speed(self) -> float:
        return float(np.abs([self.low[0], self.high[0]]).max())

    def commands(self, actions: np.ndarray) -> np.ndarray:
        shares = (np.clip(actions, -1.0, 1.0).astype(float) + 1.0) / 2.0
        return self.low + shares * (self.high - self.low)

    def kinds(self, actions: np.ndarray) -> np.ndarray:
        v, w = self.commands(np.asarray(actions)).T
        barely_v, barely_w = self._BARELY * np.abs([self.low, self.high]).max(axis=0)
        cases = [w > barely_w, w < -barely_w, v > barely_v, v < -barely_v]
        return np.select(cases, [self.names.index(name) for name in ("left", "right", "forward", "backward")], 0)

    def checked(self, action: Any) -> np.ndarray:
        values = np.asarray(action)
        if values.shape != (2,) or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            raise InputError(one_line(f"action {action!r} is not two numbers from -1 to 1"))
        return values[None].astype(float)

    def nearest(self, command: np.ndarray) -> np.ndarray:
        span = np.maximum(self.high - self.low, 1e-9)
        return np.clip(2.0 * (command - self.low) / span - 1.0, -1.0, 1.0).astype(np.float32)

    def describe(self, action: Any) -> str:
        v, w = self.commands(np.asarray([action]))[0]
        return f"{v:.2f}, {w:+.2f}"


def _pair(values: Any, name: str, meaning: str) -> np.ndarray:
    try:
        pair = np.array(values, dtype=float)
    except (TypeError, ValueError):
        pair = np.empty(0)
    if pair.shape != (2,) or not np.isfinite(pair).all():
        raise InputError(one_line(f"action {name!r} needs two numbers, {meaning}, got {values!r}"))
    return pair
