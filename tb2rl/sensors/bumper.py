"""Whether the robot touches a wall."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class Bumper(Sensor):
    """1 if the base touched a wall, or something that moves, since the last reading, else 0."""

    name = "bumper"
    low, high = 0.0, 1.0
    bins = (0.5,)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.bumped[:, None].astype(float)


def bumper_at(angle: float) -> int:
    """Which of the Kobuki's bumpers an obstacle in this direction [rad] presses: 0 left, 1 in the middle, 2 right.

    They are 60 degrees wide each, in front.
    """
    return 0 if angle > math.pi / 6 else 2 if angle < -math.pi / 6 else 1
