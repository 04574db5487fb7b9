"""The base class of sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.simulation import RobotState, SimulationSpec, SimulatorType


class Sensor(ABC):
    """Numbers or one image in the observation.

        class Compass(Sensor):
            name, unit = "compass", "rad"
            low, high = -math.pi, math.pi
            bins = (-1.57, 0.0, 1.57)

            def read(self, robot_state):
                return robot_state.pose[:, 2:]

    Attributes:
        name: Its name; the key of an image in the observation.
        unit: Of its numbers: "m", "rad", "m/s", ...; "" for none.
        low, high: Bounds; values are clipped to them.
        bins: Strictly increasing borders of the bins for tabular agents; empty: it can only be observed raw.
        shape: Of one environment's values: (n,) for n numbers, (channels, height, width) for an image of uint8.
        reads_pose_history: Whether it reads `RobotState.pose_history`.
        reads_commands: Number of commands that it reads from `RobotState.command_history`; if any, it reads nothing
            else.
        spec_arguments: Arguments of its class that `task.observe` takes from the `SimulationSpec`: "robot", "laser".
    """

    name: str
    unit: str = ""
    low: float
    high: float
    bins: tuple[float, ...] = ()
    shape: tuple[int, ...] = (1,)
    reads_pose_history: bool = False
    reads_commands: int = 0
    spec_arguments: tuple[str, ...] = ()

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        """Arguments of the class that the robot and the worlds determine, when `task.observe` names the sensor."""
        return {name: getattr(spec, name) for name in cls.spec_arguments}

    def check(self, simulator: SimulatorType) -> None:  # noqa: B027 (most sensors work in all)
        """Raise an `InputError` if a simulator cannot provide what the sensor reads."""

    @abstractmethod
    def read(self, robot_state: RobotState) -> np.ndarray:
        """Values, shape (num_envs, *shape)."""
