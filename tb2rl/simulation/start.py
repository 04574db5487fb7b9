"""The start of an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tb2rl.simulation.setup import (
    BOUNDS,
    COMMAND_LATENCY,
    GOAL,
    PARAMETERS,
    POSE,
    READING_LATENCY,
    WAY,
    WORLD,
    Setup,
)


@dataclass(frozen=True)
class Start:
    """Where each robot begins, in which world, to get where, and what kind of robot it is this time.

    A task makes one by `proposed` and then overwrites what is to be different: `start.goal[:] = (1.0, 2.0)`.

    Attributes:
        table: A row of columns for each robot, see `tb2rl.simulation.setup`; shape (robots, columns).
    """

    table: np.ndarray

    @classmethod
    def proposed(cls, setup: Setup, robots: int, world: int | np.ndarray = 0) -> Start:
        """What worlds propose: their start pose, goal and bounds, with the robot as it is.

        Args:
            setup: The worlds and the robot.
            robots: How many begin.
            world: Index of the world that all begin in, or of each one's world, shape (robots,).
        """
        if isinstance(world, int):
            return cls(setup.table[world : world + 1].repeat(robots, axis=0))
        return cls(setup.table[world])

    @property
    def pose(self) -> np.ndarray:
        """Where: x [m], y [m], yaw [rad], shape (robots, 3); to be overwritten in place, like all that follow."""
        return self.table[:, POSE]

    @property
    def world(self) -> np.ndarray:
        """Index into `Setup.worlds`, shape (robots,), as whole numbers of type float."""
        return self.table[:, WORLD]

    @property
    def goal(self) -> np.ndarray:
        """Where to get: x, y [m], shape (robots, 2); NaN for a robot without a goal."""
        return self.table[:, GOAL]

    @property
    def way(self) -> np.ndarray:
        """Number of the goal among those of its world that ways are known to, shape (robots,), as floats.

        What names such a goal says so here as well; others have no ways, see `tb2rl.worlds.ways`.
        """
        return self.table[:, WAY]

    @property
    def bounds(self) -> np.ndarray:
        """The rectangle x from, y from, x to, y to [m] that counts as the world, shape (robots, 4)."""
        return self.table[:, BOUNDS]

    @property
    def parameters(self) -> np.ndarray:
        """A row of `Robot.parameters` for each robot, shape (robots, 6).

        The twin takes all of them; PyBullet takes all but the radius, which is that of the URDF file.
        """
        return self.table[:, PARAMETERS]

    @property
    def command_latency(self) -> np.ndarray:
        """Control steps until a command is obeyed, shape (robots,), as whole numbers of type float."""
        return self.table[:, COMMAND_LATENCY]

    @property
    def reading_latency(self) -> np.ndarray:
        """Control steps until a reading is observed, shape (robots,), as whole numbers of type float."""
        return self.table[:, READING_LATENCY]
