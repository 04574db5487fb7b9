"""What robots remember of the episode that each is in, beyond what they observe at an instant."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np

from tb2rl.simulation import Reading


class Memory(ABC):
    """Some values for each robot, which a reading brings to the sensors.

    Attributes:
        field: Of `Reading`, under which sensors find it.
    """

    field: ClassVar[str]

    def __init__(self) -> None:
        self._rows: dict[str, np.ndarray] = {}  # by name, one row a robot

    @abstractmethod
    def blank(self, robots: int) -> dict[str, np.ndarray]:
        """The values of so many robots that remember nothing, by name, each of shape (robots, ...)."""

    @abstractmethod
    def go_on(self, reading: Reading) -> None:
        """Note what all robots read now."""

    def begin(self, reading: Reading) -> None:
        """Forget all; the episodes of all robots begin."""
        self._rows = self.blank(len(reading.pose))
        self.go_on(reading)

    def begin_some(self, robots: np.ndarray, reading: Reading) -> None:
        """Forget what some robots, by their indices (n,), remember; `reading`, of these alone, is their first."""
        some = copy(self)
        some.begin(reading)
        for name, values in some._rows.items():
            self._rows[name][robots] = values

    def of(self, robots: np.ndarray) -> Self:
        """What some robots, by their indices (n,), remember."""
        some = copy(self)
        some._rows = {name: values[robots] for name, values in self._rows.items()}
        return some

    def state(self) -> dict[str, Any]:
        """All values, in arrays of their own."""
        return {name: values.copy() for name, values in self._rows.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`."""
        self._rows = {name: np.array(values) for name, values in state.items()}
