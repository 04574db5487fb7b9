"""The laser's ranges."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.core.values import Bins
from tb2rl.robots import Laser
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState, SimulationSpec


class LaserRanges(Sensor):
    """Distances along the laser's beams [m], right to left.

    Args:
        laser: Which beams there are, and how far they reach.
        bins: Borders of the distance classes [m].
    """

    name, unit = "laser", "m"

    def __init__(self, laser: Laser, bins: Bins) -> None:
        self.low, self.high = laser.min_range, laser.max_range
        self.bins = bins
        self.shape = (len(laser.angles),)

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        return {"laser": spec.laser}

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.ranges
