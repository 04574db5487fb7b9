"""What a simulation is made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tb2rl.robots import Laser, Robot
from tb2rl.worlds import World

PHYSICS_RATE = 80.0  # [Hz] 60 Hz holds every speed too, but hits a wall up to 9 mm deep; 100 Hz costs a third more

# The columns of a table of starts, which the compiled kernels read: one row for each robot.
POSE, WORLD, GOAL, BOUNDS, PARAMETERS, COLUMNS = slice(0, 3), 3, slice(4, 6), slice(6, 10), slice(10, 16), 16


@dataclass(frozen=True, eq=False)
class Setup:
    """A robot, the laser that it reads, and the worlds that its episodes can be in.

    Attributes:
        robot: What drives.
        laser: The robot's laser with the beams and the noise that the task asks for.
        worlds: At least one; a `Start` names one by its index.
    """

    robot: Robot
    laser: Laser
    worlds: tuple[World, ...]

    @cached_property
    def table(self) -> np.ndarray:
        """The start that each world proposes, a row of columns as above for each, shape (worlds, 16)."""
        table = np.empty((len(self.worlds), COLUMNS))
        for number, world in enumerate(self.worlds):
            table[number, POSE] = world.start
            table[number, WORLD] = number
            table[number, GOAL] = world.goal[:2] if world.goal else np.nan
            table[number, BOUNDS] = world.bounds
        table[:, PARAMETERS] = self.robot.parameters
        return table
