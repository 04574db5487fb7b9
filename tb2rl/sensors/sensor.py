"""What every sensor says of itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.simulation import RobotState, SimulationSpec, SimulatorType


class Sensor(ABC):
    """Some numbers, or one image, that a learner observes.

        class Compass(Sensor):
            name, unit = "compass", "rad"
            low, high = -math.pi, math.pi
            bins = (-1.57, 0.0, 1.57)

            def read(self, reading):
                return reading.pose[:, 2:]

    Attributes:
        name: What it is called; an image stands under this name in the observation.
        unit: Of its numbers: "m", "rad", "m/s", ...; "" for a plain number.
        low, high: The smallest and the largest value; what is read is cut to them.
        bins: Strictly increasing borders of the classes that tabular learners see; empty: it has none, and can only
            be observed raw.
        shape: Of what it reads for one robot: (n,) for n numbers, (channels, height, width) for an image of uint8.
        reads_pose_history: Whether it reads `RobotState.pose_history`.
        reads_commands: How many of the last commands it reads from `RobotState.told`; if any, it reads nothing else.
    """

    name: str
    unit: str = ""
    low: float
    high: float
    bins: tuple[float, ...] = ()
    shape: tuple[int, ...] = (1,)
    reads_pose_history: bool = False
    reads_commands: int = 0

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        """The arguments of the class that the robot decides, where `task.observe` names the sensor."""
        return {}

    def check(self, simulator: SimulatorType) -> None:  # noqa: B027 (most sensors read in all)
        """Raise an `InputError` if a simulator cannot show what it reads."""

    @abstractmethod
    def read(self, robot_state: RobotState) -> np.ndarray:
        """The values, shape (num_envs, *shape)."""
