"""The start of an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tb2rl.simulation.spec import (
    BOUNDS,
    COMMAND_LATENCY,
    GOAL,
    OBSERVATION_LATENCY,
    PARAMETERS,
    POSE,
    WAY,
    WORLD,
    SimulationSpec,
)


@dataclass(frozen=True)
class InitialState:
    """Where each robot begins, in which world, to get where, and what kind of robot it is this time.

    A task makes one by `default` and then overwrites what is to be different: `start.goal[:] = (1.0, 2.0)`.

    Attributes:
        table: A row of columns for each robot, see `tb2rl.simulation.spec`; shape (num_envs, columns).
    """

    table: np.ndarray

    @classmethod
    def default(cls, spec: SimulationSpec, num_envs: int, world: int | np.ndarray = 0) -> InitialState:
        """What worlds propose: their start pose, goal and bounds, with the robot as it is.

        Args:
            spec: The worlds and the robot.
            num_envs: How many begin.
            world: Index of the world that all begin in, or of each one's world, shape (num_envs,).
        """
        if isinstance(world, int):
            return cls(spec.table[world : world + 1].repeat(num_envs, axis=0))
        return cls(spec.table[world])

    @property
    def pose(self) -> np.ndarray:
        """Where: x [m], y [m], yaw [rad], shape (num_envs, 3); to be overwritten in place, like all that follow."""
        return self.table[:, POSE]

    @property
    def world(self) -> np.ndarray:
        """Index into `SimulationSpec.worlds`, shape (num_envs,), as whole numbers of type float."""
        return self.table[:, WORLD]

    @property
    def goal(self) -> np.ndarray:
        """Where to get: x, y [m], shape (num_envs, 2); NaN for a robot without a goal."""
        return self.table[:, GOAL]

    @property
    def way(self) -> np.ndarray:
        """Number of the goal among those of its world that ways are known to, shape (num_envs,), as floats.

        What names such a goal says so here as well; others have no ways, see `tb2rl.worlds.goal_paths`.
        """
        return self.table[:, WAY]

    @property
    def bounds(self) -> np.ndarray:
        """The rectangle x from, y from, x to, y to [m] that counts as the world, shape (num_envs, 4)."""
        return self.table[:, BOUNDS]

    @property
    def parameters(self) -> np.ndarray:
        """A row of `Robot.parameters` for each robot, shape (num_envs, 6).

        The twin takes all of them; PyBullet takes all but the radius, which is that of the URDF file.
        """
        return self.table[:, PARAMETERS]

    @property
    def command_latency(self) -> np.ndarray:
        """Control steps until a command is obeyed, shape (num_envs,), as whole numbers of type float."""
        return self.table[:, COMMAND_LATENCY]

    @property
    def observation_latency(self) -> np.ndarray:
        """Control steps until a reading is observed, shape (num_envs,), as whole numbers of type float."""
        return self.table[:, OBSERVATION_LATENCY]
