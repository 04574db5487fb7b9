"""Laser sensors: ranges, and collision-free distances of the robot in several directions."""

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from tb2rl.core.compiled import NO_REFCOUNT, njit
from tb2rl.core.errors import InputError
from tb2rl.core.values import Bins, NonNegative
from tb2rl.robots import Laser, Robot
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState


class LaserRanges(Sensor):
    """Ranges of the laser's beams [m], right to left. `bins` [m] are the bin edges of discretized ranges."""

    name, unit = "laser", "m"

    def __init__(self, laser: Laser, bins: Bins) -> None:
        self.low, self.high, self.bins = laser.min_range, laser.max_range, bins
        self.shape = (len(laser.angles),)

    def read(self, robot_state: RobotState) -> np.ndarray:
        return robot_state.ranges


class FreePaths(Sensor):
    """Collision-free straight distances in several directions [m], right to left.

    Unlike single ranges, these distances show whether the robot fits through a door. A disc moves from the robot until
    it touches a point that a beam has hit, as in the dynamic window approach (Fox, Burgard & Thrun 1997).

    Args:
        robot: The robot, for its radius.
        laser: The laser with the beams of the task; obstacles between two beams are not detected.
        count: Number of directions.
        spread: Angle from the first direction to the last [rad].
        gap: Radius of the disc minus that of the robot [m].
        bins: Borders between bins [m]; distances are clipped to twice the last border.

    Attributes:
        radius: Radius of the disc [m].
        directions: Directions in the robot's frame [rad], shape (count,).

    Raises:
        InputError: If `spread` exceeds the laser's field of view.
    """

    name, unit, low = "free paths", "m", 0.0

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
            raise InputError("free paths span {:.0f} degrees, but the laser only {:.0f}; lower spread".format(*degrees))
        self.bins, self.high, self.shape = bins, 2 * bins[-1], (count,)
        self.radius, self.directions = robot.radius + gap, np.linspace(-spread / 2, spread / 2, count)
        angles = laser.angles - self.directions[:, None]
        self._cos, self._sin = np.cos(angles), np.sin(angles)

    def read(self, robot_state: RobotState) -> np.ndarray:
        distances = np.full((len(robot_state.ranges), *self.shape), self.high)
        _shorten(distances, robot_state.ranges, self._cos, self._sin, self.radius)
        return distances


@njit(cache=True, **NO_REFCOUNT)
def _shorten(distances, ranges, cos, sin, radius):
    """Shorten `distances` (num_envs, directions) to where a disc touches the points that beams have hit.

    cos, sin: Cosine and sine of the angle from a direction to a beam, shape (directions, beams).
    """
    for i in range(distances.shape[0]):
        for direction in range(distances.shape[1]):
            for beam in range(ranges.shape[1]):
                y = ranges[i, beam] * sin[direction, beam]
                if abs(y) < radius and cos[direction, beam] > 0.0:
                    distance = ranges[i, beam] * cos[direction, beam] - math.sqrt(radius**2 - y**2)
                    distances[i, direction] = min(distances[i, direction], max(distance, 0.0))
