"""The shortest range in each sector of the laser: few numbers that miss nothing, however small."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tb2rl.errors import InputError
from tb2rl.robots import Laser
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import Reading, Setup
from tb2rl.values import Count, Edges


class Sectors(Sensor):
    """The shortest range of neighbouring beams [m], sector by sector, right to left.

    Args:
        laser: Whose beams, `task.beams` of them.
        count: Into how many sectors they are shared out, of as many beams as can be.
        edges: Borders of the distance classes [m].

    Raises:
        InputError: If there are fewer beams than sectors.
    """

    name, unit = "sectors", "m"

    def __init__(self, laser: Laser, count: Count = 7, edges: Edges = (0.7, 1.0, 1.7)) -> None:
        beams = len(laser.angles)
        if count > beams:
            raise InputError(f"{count} sectors need as many beams, and the laser has {beams}; set task.beams")
        self.low, self.high = laser.min_range, laser.max_range
        self.edges = edges
        self.shape = (count,)
        self._first = np.arange(count) * beams // count

    @classmethod
    def given(cls, setup: Setup) -> Mapping[str, Any]:
        return {"laser": setup.laser}

    def read(self, reading: Reading) -> np.ndarray:
        return np.minimum.reduceat(reading.ranges, self._first, axis=1)
