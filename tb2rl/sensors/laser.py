"""The laser's ranges."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.core.values import Edges
from tb2rl.robots import Laser
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import Reading, Setup


class LaserRanges(Sensor):
    """Distances along the laser's beams [m], right to left.

    Args:
        laser: Which beams there are, and how far they reach.
        edges: Borders of the distance classes [m].
    """

    name, unit = "laser", "m"

    def __init__(self, laser: Laser, edges: Edges) -> None:
        self.low, self.high = laser.min_range, laser.max_range
        self.edges = edges
        self.shape = (len(laser.angles),)

    @classmethod
    def given(cls, setup: Setup) -> Mapping[str, Any]:
        return {"laser": setup.laser}

    def read(self, reading: Reading) -> np.ndarray:
        return reading.ranges
