"""A scripted policy, and scans of given ranges."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.deploy import Needs, Scan

NEEDS = Needs(np.linspace(-math.pi / 2, math.pi / 2, 37), 0.1, 30.0, 0.2, max_speed=0.5, max_turn_rate=1.0, robot="any")


class ScriptedPolicy:
    """Returns `speeds` and keeps the sensor data of each episode."""

    def __init__(self, **needs) -> None:
        self.needs = replace(NEEDS, **needs)
        self.speeds = 0.4, 0.2
        self.episodes: list[list] = []

    def reset(self):
        self.episodes.append([])

    def act(self, sensed):
        self.episodes[-1].append(sensed)
        return self.speeds


@pytest.fixture
def scripted_policy() -> type[ScriptedPolicy]:
    return ScriptedPolicy


@pytest.fixture
def scan_of() -> Callable[..., Scan]:
    """A function that makes a scan of ranges over a field of view, by default the half circle ahead."""

    def scan(ranges, field: float = math.pi, range_min: float = 0.1, range_max: float = 30.0) -> Scan:
        ranges = np.asarray(ranges, dtype=float)
        return Scan(ranges, -field / 2, field / (len(ranges) - 1), range_min, range_max)

    return scan
