"""The base class of sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.simulation import RobotState, SimulationSpec, SimulatorType


class Sensor(ABC):
    """Numbers or one image in the observation, such as:

        class Compass(Sensor):
            name, unit = "compass", "rad"
            low, high = -math.pi, math.pi
            bins = (-1.57, 0.0, 1.57)

            def read(self, robot_state):
                return robot_state.odometry[:, 2:]

    It holds settings only, because one sensor reads all environments.
    """

    name: str  # the key of an image in the observation
    unit: str = ""  # "m", "rad", "m/s", ...
    low: float  # values are clipped to low and high
    high: float
    bins: tuple[float, ...] = ()  # strictly increasing borders, for tabular agents; empty: it can only be observed raw
    shape: tuple[int, ...] = (1,)  # (n,) for n numbers, (channels, height, width) for an image of uint8
    reads_pose_history: bool = False  # see `RobotState.pose_history`
    reads_commands: int = 0  # of `RobotState.command_history`; a sensor of commands reads nothing else
    spec_arguments: tuple[str, ...] = ()  # constructor arguments that are fields of `SimulationSpec`

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        """Constructor arguments that the robot and the worlds determine, for a sensor in `task.observe`."""
        return {name: getattr(spec, name) for name in cls.spec_arguments}

    def check(self, simulator: SimulatorType) -> None:  # noqa: B027 (most sensors work in all)
        """Raise an `InputError` if a simulator lacks the data of the sensor."""

    @abstractmethod
    def read(self, robot_state: RobotState) -> np.ndarray:
        """Values, shape (num_envs, *shape)."""
