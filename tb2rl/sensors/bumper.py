"""Contact with an obstacle."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class Bumper(Sensor):
    """1 after a contact of the base since the last state, else 0."""

    name = "bumper"
    low, high = 0.0, 1.0
    bins = (0.5,)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.bumped[:, None].astype(float)


def bumper_at(angle: float) -> int:
    """The Kobuki's bumper in this direction [rad]: 0 left, 1 centre, 2 right; each covers 60 degrees of the front."""
    return 0 if angle > math.pi / 6 else 2 if angle < -math.pi / 6 else 1
