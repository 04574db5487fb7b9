"""Free distances in several directions."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.core.errors import InputError
from tb2rl.core.values import Bins, NonNegative
from tb2rl.robots import Laser, Robot
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class FreePaths(Sensor):
    """Distances that the robot's whole width can drive straight ahead in several directions [m], right to left.

    Ranges do not tell whether the robot fits through a door; this does: it moves a disc until it touches the first
    point that a beam has hit, as the dynamic window approach does (Fox, Burgard & Thrun 1997), on straight paths.

    Args:
        robot: Its radius plus `gap` is the disc's.
        laser: Its `task.beams` beams; obstacles between two beams are not seen.
        count: Number of directions.
        spread: Angle from the first direction to the last [rad].
        gap: Between robot and disc [m].
        bins: Borders of the bins [m]; distances are clipped to twice the last.

    Attributes:
        radius: Of the disc [m].
        directions: In the robot's frame [rad], shape (count,).

    Raises:
        InputError: If `spread` exceeds the laser's field of view.
    """

    name, unit, low, spec_arguments = "free paths", "m", 0.0, ("robot", "laser")

    def __init__(
        self,
        robot: Robot,
        laser: Laser,
        count: Annotated[int, Ge(2), Le(1000)] = 7,
        spread: Annotated[float, Gt(0), Le(math.tau)] = 2.0944,  # 120 degrees
        gap: NonNegative = 0.03,
        bins: Bins = (0.15, 0.6),
    ) -> None:
        if spread > laser.field_of_view:
            degrees = np.degrees([spread, laser.field_of_view])
            raise InputError("free paths over {:.0f} degrees, and the laser sees {:.0f}".format(*degrees))
        self.bins, self.high, self.shape = bins, 2 * bins[-1], (count,)
        self.radius, self.directions = robot.radius + gap, np.linspace(-spread / 2, spread / 2, count)
        between = laser.angles - self.directions[:, None]
        self._ahead, self._aside = np.cos(between), np.sin(between)

    def read(self, robot_state: RobotState) -> np.ndarray:
        distances = np.full((len(robot_state.ranges), *self.shape), self.high)
        _shorten(distances, robot_state.ranges, self._ahead, self._aside, self.radius)
        return distances


@njit(cache=True, **UNCOUNTED)
def _shorten(distances, ranges, ahead, aside, radius):
    """Shorten distances [m], shape (num_envs, directions), to where a disc touches the points that beams have hit.

    ahead, aside: Cosine and sine of the angle from a direction to a beam, shape (directions, beams).
    """
    for i in range(distances.shape[0]):
        for direction in range(distances.shape[1]):
            for beam in range(ranges.shape[1]):
                beside = ranges[i, beam] * aside[direction, beam]
                if abs(beside) < radius and ahead[direction, beam] > 0.0:
                    before = ranges[i, beam] * ahead[direction, beam] - math.sqrt(radius**2 - beside**2)
                    distances[i, direction] = min(distances[i, direction], max(before, 0.0))
