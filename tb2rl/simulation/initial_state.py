"""How episodes start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tb2rl.simulation.spec import BOUNDS, GOAL, PARAMETERS, POSE, SimulationSpec, as_rows


@dataclass(frozen=True)
class InitialState:
    """Pose, world and goal of each environment at the start of its episode, and its variation of the robot.

    A task takes `default` and overwrites what differs: `initial_state.goal[:] = (1.0, 2.0)`. All properties are views.

    Attributes:
        table: The columns of `tb2rl.simulation.spec.FIELDS`, shape (num_envs, len(FIELDS)).
    """

    table: np.ndarray

    @classmethod
    def default(cls, spec: SimulationSpec, num_envs: int, world: int | np.ndarray = 0) -> InitialState:
        """The start pose, goal and bounds of the worlds, with the nominal robot.

        Args:
            spec: The worlds and the robot.
            num_envs: Number of rows.
            world: Index of the world of all, or of each, shape (num_envs,).
        """
        if isinstance(world, int):
            return cls(spec.table[world : world + 1].repeat(num_envs, axis=0))
        return cls(spec.table[world])

    @property
    def rows(self) -> np.ndarray:
        """The table as records, shape (num_envs,)."""
        return as_rows(self.table)

    @property
    def pose(self) -> np.ndarray:
        """X [m], y [m], yaw [rad], shape (num_envs, 3)."""
        return self.table[:, POSE]

    @property
    def world(self) -> np.ndarray:
        """Index into `SimulationSpec.worlds`, shape (num_envs,), as floats."""
        return self.rows["world"]

    @property
    def goal(self) -> np.ndarray:
        """x, y [m], shape (num_envs, 2); NaN: no goal."""
        return self.table[:, GOAL]

    @property
    def goal_path(self) -> np.ndarray:
        """Number of the goal in `SimulationSpec.goal_paths`, shape (num_envs,), as floats.

        A task whose goal is one of those says so here as well; other goals have no paths.
        """
        return self.rows["goal_path"]

    @property
    def bounds(self) -> np.ndarray:
        """The rectangle x from, y from, x to, y to [m] that counts as the world, shape (num_envs, 4)."""
        return self.table[:, BOUNDS]

    @property
    def parameters(self) -> np.ndarray:
        """Rows of `Robot.parameters`, shape (num_envs, 6); a physics takes the radius from the URDF file instead."""
        return self.table[:, PARAMETERS]

    @property
    def command_latency(self) -> np.ndarray:
        """Control steps until a command takes effect, shape (num_envs,), as floats."""
        return self.rows["command_latency"]

    @property
    def observation_latency(self) -> np.ndarray:
        """Control steps until a robot state is observed, shape (num_envs,), as floats."""
        return self.rows["observation_latency"]
