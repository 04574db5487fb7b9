"""What robots remember of the episode that each is in, beyond what they observe at an instant."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np

from tb2rl.simulation import RobotState


class EpisodeState(ABC):
    """Some values for each robot, which a reading brings to the sensors.

    Attributes:
        field: Of `RobotState`, under which sensors find it.
    """

    field: ClassVar[str]

    def __init__(self) -> None:
        self._rows: dict[str, np.ndarray] = {}  # by name, one row a robot

    @abstractmethod
    def blank(self, num_envs: int) -> dict[str, np.ndarray]:
        """The values of so many robots that remember nothing, by name, each of shape (num_envs, ...)."""

    @abstractmethod
    def go_on(self, robot_state: RobotState) -> None:
        """Note what all robots read now."""

    def begin(self, robot_state: RobotState) -> None:
        """Forget all; the episodes of all robots begin."""
        self._rows = self.blank(len(robot_state.pose))
        self.go_on(robot_state)

    def begin_some(self, indices: np.ndarray, robot_state: RobotState) -> None:
        """Forget what some robots, by their indices (n,), remember; `robot_state`, of these alone, is their first."""
        some = copy(self)
        some.begin(robot_state)
        for name, values in some._rows.items():
            self._rows[name][indices] = values

    def of(self, indices: np.ndarray) -> Self:
        """What some robots, by their indices (n,), remember."""
        some = copy(self)
        some._rows = {name: values[indices] for name, values in self._rows.items()}
        return some

    def state(self) -> dict[str, Any]:
        """All values, in arrays of their own."""
        return {name: values.copy() for name, values in self._rows.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`."""
        self._rows = {name: np.array(values) for name, values in state.items()}
