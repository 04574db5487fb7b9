"""The laser's ranges."""

from __future__ import annotations

import numpy as np

from tb2rl.core.values import Bins
from tb2rl.robots import Laser
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class LaserRanges(Sensor):
    """Ranges of the laser's beams [m], right to left; `bins` are in metres, too."""

    name, unit, spec_arguments = "laser", "m", ("laser",)

    def __init__(self, laser: Laser, bins: Bins) -> None:
        self.low, self.high, self.bins = laser.min_range, laser.max_range, bins
        self.shape = (len(laser.angles),)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.ranges
