"""Memory of an environment during an episode, beyond the present robot state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np

from tb2rl.simulation import RobotState


class EpisodeState(ABC):
    """Values of each environment, which sensors find in the robot state.

    Attributes:
        field: Name in `RobotState`.
    """

    field: ClassVar[str]

    def __init__(self) -> None:
        self._rows: dict[str, np.ndarray] = {}  # by name, one row for each environment

    @abstractmethod
    def blank(self, num_envs: int) -> dict[str, np.ndarray]:
        """The values at the start of episodes, by name, each of shape (num_envs, ...)."""

    @abstractmethod
    def update(self, robot_state: RobotState) -> None:
        """Take in the present state of all robots."""

    def reset(self, robot_state: RobotState) -> None:
        """Start an episode in every environment."""
        self._rows = self.blank(len(robot_state.pose))
        self.update(robot_state)

    def reset_at(self, indices: np.ndarray, robot_state: RobotState) -> None:
        """Start episodes in the environments `indices` (n,); `robot_state` has n rows."""
        some = copy(self)
        some.reset(robot_state)
        for name, values in some._rows.items():
            self._rows[name][indices] = values

    def rows(self, indices: np.ndarray) -> Self:
        """That of some environments, by their indices (n,)."""
        some = copy(self)
        some._rows = {name: values[indices] for name, values in self._rows.items()}
        return some

    def state(self) -> dict[str, Any]:
        """All values, copied."""
        return {name: values.copy() for name, values in self._rows.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state`."""
        self._rows = {name: np.array(values) for name, values in state.items()}
