"""How far the robot can drive straight ahead in several directions: what decides where it may go, in few numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le

from tb2rl.core.compiled import UNCOUNTED, njit
from tb2rl.core.errors import InputError
from tb2rl.core.values import Bins, NonNegative
from tb2rl.robots import Laser, Robot
from tb2rl.sensors.sensor import Sensor
from tb2rl.simulation import RobotState, SimulationSpec


class FreePaths(Sensor):
    """How far the robot, as wide as it is, could drive straight ahead in each of some directions [m], right to left.

    The shortest range ahead of a doorway is the same whether the robot fits or not; this says how far it gets: the way
    of a circle until it touches the first point that a beam has hit, which is the obstacle distance of the dynamic
    window approach (Fox, Burgard & Thrun 1997) on straight ways.

    Args:
        robot: Its radius is the circle's.
        laser: Whose beams, `task.beams` of them: what stands between two beams is not seen.
        count: Of directions.
        spread: The angle from the first direction to the last [rad].
        gap: By how much the circle is wider than the robot on every side [m].
        bins: Borders of the classes [m]; no way counts as longer than twice the last.

    Attributes:
        radius: Of the circle [m].
        directions: In the robot's frame [rad], shape (count,).

    Raises:
        InputError: If there are directions in which the laser does not look.
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
            raise InputError("free paths over {:.0f} degrees, and the laser sees {:.0f}".format(*degrees))
        self.bins, self.high, self.shape = bins, 2 * bins[-1], (count,)
        self.radius, self.directions = robot.radius + gap, np.linspace(-spread / 2, spread / 2, count)
        between = laser.angles - self.directions[:, None]
        self._ahead, self._aside = np.cos(between), np.sin(between)

    @classmethod
    def given(cls, spec: SimulationSpec) -> Mapping[str, Any]:
        return {"robot": spec.robot, "laser": spec.laser}

    def read(self, robot_state: RobotState) -> np.ndarray:
        free = np.full((len(robot_state.ranges), *self.shape), self.high)
        _shorten(free, robot_state.ranges, self._ahead, self._aside, self.radius)
        return free


@njit(cache=True, **UNCOUNTED)
def _shorten(free, ranges, ahead, aside, radius):
    """Shorten the ways [m], shape (num_envs, directions), to where a circle touches what the beams have hit.

    ahead, aside: Cosine and sine of the angle from a direction to a beam, shape (directions, beams).
    """
    for robot in range(free.shape[0]):
        for direction in range(free.shape[1]):
            for beam in range(ranges.shape[1]):
                beside = ranges[robot, beam] * aside[direction, beam]
                if abs(beside) < radius and ahead[direction, beam] > 0.0:
                    before = ranges[robot, beam] * ahead[direction, beam] - math.sqrt(radius**2 - beside**2)
                    free[robot, direction] = min(free[robot, direction], max(before, 0.0))
