"""The base class of sensors."""

from abc import ABC, abstractmethod

import numpy as np

from tb2rl.simulation import RobotState, SimulatorType


class Sensor(ABC):
    """A source of numbers, or of one image, in the observation. Example::

        class Compass(Sensor):
            name, unit = "compass", "rad"
            low, high = -math.pi, math.pi
            bins = (-1.57, 0.0, 1.57)

            def read(self, robot_state):
                return robot_state.odometry[:, 2:]

    A sensor has settings but no memory, because one object reads all environments. If `task.observe` lists it, the
    arguments `robot`, `laser`, `camera` and `worlds` of its constructor come from the scene.
    """

    name: str  # also the key of an image in a `Dict` observation
    unit: str = ""  # "m", "rad", "m/s", ...
    low: float  # values are clipped to low and high
    high: float
    bins: tuple[float, ...] = ()  # increasing borders between bins, for tabular agents; empty: only raw observations
    shape: tuple[int, ...] = (1,)  # (n,) for n numbers, (channels, height, width) for an image of uint8
    reads_position_history: bool = False  # whether `read` needs the positions of the last minute
    command_history_length: int = 0  # commands that `read` needs; above 0 the sensor is not delayed

    def check(self, simulator: SimulatorType) -> None:  # noqa: B027 (most sensors work in all simulators)
        """Raise an `InputError` if a simulator lacks the data of the sensor."""

    @abstractmethod
    def read(self, robot_state: RobotState) -> np.ndarray:
        """Values, shape (num_envs,) + `shape`."""
