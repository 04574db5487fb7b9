"""What a robot believes of its way: it counts how its wheels turn, and takes them for what they should be.

Borenstein and Feng 1996, "Measurement and correction of systematic odometry errors in mobile robots".
"""

from __future__ import annotations

import math

import numpy as np

from tb2rl.robots.robot import WHEEL_SEPARATION
from tb2rl.simulation.setup import BELIEVED_SEPARATION, LEFT_COUNT, RIGHT_COUNT, WHEEL
from tb2rl.simulation.start import Start


def is_exact(start: Start) -> bool:
    """Whether the wheels of all robots are what they should be, so that odometry is what they did."""
    return bool((start.table[:, [WHEEL, BELIEVED_SEPARATION, LEFT_COUNT, RIGHT_COUNT]] == 1.0).all())


def believed(ways: np.ndarray, start: Start) -> np.ndarray:
    """Ways as the robots count them.

    Args:
        ways: How far each went [m] and turned [rad], or how fast, shape (robots, 2); of one robot any number of rows.
        start: How the episode of each began.
    """
    table, separation = start.table, start.parameters[:, WHEEL_SEPARATION]
    half = 0.5 * separation * ways[:, 1]
    left = (ways[:, 0] - half) * table[:, LEFT_COUNT] / table[:, WHEEL]
    right = (ways[:, 0] + half) * table[:, RIGHT_COUNT] / table[:, WHEEL]
    turn = (right - left) / (separation * table[:, BELIEVED_SEPARATION])
    return np.stack([0.5 * (left + right), turn], axis=1)


def count_on(odometry: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Odometry (robots, 3) after arcs: `ways` (robots, 2) are their lengths [m] and turns [rad]."""
    half = 0.5 * ways[:, 1]
    chord, heading = ways[:, 0] * np.sinc(half / math.pi), odometry[:, 2] + half
    yaw = odometry[:, 2] + ways[:, 1]
    yaw -= math.tau * np.floor((yaw + math.pi) / math.tau)
    return np.stack([odometry[:, 0] + chord * np.cos(heading), odometry[:, 1] + chord * np.sin(heading), yaw], axis=1)
