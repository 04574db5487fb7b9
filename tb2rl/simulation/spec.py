"""What a simulator is made of, and the table of initial states that its kernels read."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tb2rl.robots import Laser, Robot
from tb2rl.simulation.random_streams import Draws
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.goal_paths import GOALS, OWN, GoalPaths
from tb2rl.worlds.places import Places

PHYSICS_RATE = 80.0  # [Hz] 60 Hz holds every speed too, but hits a wall up to 9 mm deep; 100 Hz costs a third more
_UNDIVIDED = 0.7  # [m/s] a faster robot has its physics steps divided, see `SimulationSpec.substeps`

# A row of the table of initial states, one for each environment; compiled code reads it as a record.
FIELDS = (
    "x", "y", "yaw",  # [m, m, rad]
    "world",  # its index
    "goal_x", "goal_y",  # [m]
    "min_x", "min_y", "max_x", "max_y",  # [m] bounds of the world
    # Of the robot, in the order of `Robot.parameters`:
    "radius", "wheel_separation", "max_speed", "max_turn_rate", "wheel_acceleration", "wheel_coupling",
    # Drawn by `tb2rl.simulation.variation`:
    "wheel_radius",  # true / nominal
    "assumed_separation",  # wheel separation that the odometry assumes / the true one
    "left_encoder", "right_encoder",  # distance that a wheel's encoder counts / the true one
    "laser_noise",  # [m] standard deviation; below 0: `Laser.noise`
    "bias",  # [m] added to all ranges
    "dropped",  # share of beams that return inf
    "mount_x", "mount_y", "mount_yaw",  # [m, m, rad] true pose of the laser in its nominal frame
    "mass", "friction",  # true / nominal, of the robot and of its wheels on the floor
    "command_latency", "observation_latency",  # [control steps]
    "gyro",  # turn that the gyro counts / the true one; 0: no gyro, so the encoders give the heading
    # Of the episode:
    "obstacle_seed",  # in [0, 1): decides everything that dynamic obstacles do
    "goal_path",  # number of the goal in `GoalPaths`
)  # fmt: skip
RECORD = np.dtype([(name, np.float64) for name in FIELDS])
POSE, GOAL, BOUNDS, PARAMETERS, VARIATION = slice(0, 3), slice(4, 6), slice(6, 10), slice(10, 16), slice(16, 31)
_LARGEST_VARIATION = 10.0  # of a robot's parameters, times the nominal ones
_LEAST = np.array([0.5, 0.5, 0.5, 0.5, -1.0, -1.0, 0.0, -0.5, -0.5, -np.pi, 0.1, 0.01, 0.0, 0.0, 0.0])
_MOST = np.array([2.0, 2.0, 2.0, 2.0, np.inf, 1.0, 1.0, 0.5, 0.5, np.pi, 10.0, 10.0, 10.0, 10.0, 2.0])


def as_rows(table: np.ndarray) -> np.ndarray:
    """View a table of initial states as records, shape (num_envs,): `as_rows(table)["mass"][:] = 1.2`."""
    return table.view(RECORD)[:, 0]


@dataclass(frozen=True, eq=False)
class SimulationSpec:
    """A robot, its laser, and the worlds of its episodes.

    Attributes:
        robot: The robot.
        laser: The robot's laser, with the beams and the noise that the task asks for.
        worlds: At least one; an `InitialState` names one by its index.
        only: Index of the one world that episodes start in; None: any.
        dynamic_obstacles: In every world, beside each world's own.
    """

    robot: Robot
    laser: Laser
    worlds: tuple[World, ...]
    only: int | None = None
    dynamic_obstacles: tuple[DynamicObstacles, ...] = ()

    @cached_property
    def table(self) -> np.ndarray:
        """The default initial state in each world, shape (worlds, len(FIELDS))."""
        table = np.zeros((len(self.worlds), len(FIELDS)))
        for number, world in enumerate(self.worlds):
            table[number, POSE], table[number, BOUNDS] = world.start, world.bounds
            table[number, GOAL] = world.goal[:2] if world.goal else np.nan
        table[:, PARAMETERS] = self.robot.parameters
        rows = as_rows(table)
        rows["world"], rows["goal_path"] = np.arange(len(self.worlds)), OWN
        for nominal in ("wheel_radius", "assumed_separation", "left_encoder", "right_encoder", "mass", "friction"):
            rows[nominal] = 1.0
        rows["laser_noise"], rows["gyro"] = -1.0, float(self.robot.gyro)
        return table

    @cached_property
    def substeps(self) -> int:
        """Number of parts of a physics step, because in a whole one a fast robot would penetrate a wall.

        A power of two: Bullet counts the parts by a clock, and so never has one too few.
        """
        return 2 ** max(0, math.ceil(math.log2(self.robot.max_speed / _UNDIVIDED)))

    def dynamic_obstacles_in(self, world: int) -> tuple[DynamicObstacles, ...]:
        """The dynamic obstacles of the world with this index."""
        return (*self.dynamic_obstacles, *self.worlds[world].dynamic_obstacles)

    def without_dynamic_obstacles(self) -> SimulationSpec:
        """The same robot and worlds, without dynamic obstacles."""
        worlds = tuple(
            replace(world, dynamic_obstacles=()) if world.dynamic_obstacles else world for world in self.worlds
        )
        return replace(self, dynamic_obstacles=(), worlds=worlds)

    @cached_property
    def has_dynamic_obstacles(self) -> bool:
        """Whether any of the worlds has dynamic obstacles."""
        return bool(self.dynamic_obstacles) or any(world.dynamic_obstacles for world in self.worlds)

    @cached_property
    def goal_paths(self) -> GoalPaths:
        """Paths to goals in these worlds."""
        return GoalPaths(self.worlds, self.robot.radius)

    @cached_property
    def _places(self) -> Places:
        return Places(self.worlds, self.robot.radius)

    def within(self, world: int) -> SimulationSpec:
        """The spec whose episodes start in the world with this index alone; what is expensive to make is shared."""
        _ = self.table, self.goal_paths, self._places
        spec = copy(self)
        object.__setattr__(spec, "only", world)
        return spec

    def check_table(self, table: np.ndarray) -> None:
        """Raise a `ValueError` for a table of initial states, from a file, that does not fit this spec."""
        rows, variation, parameters = as_rows(table), table[:, VARIATION], np.abs(table[:, PARAMETERS])
        if not np.isin(rows["world"], range(len(self.worlds))).all():
            raise ValueError("a robot is in a world that is not there")
        alike = parameters <= _LARGEST_VARIATION * np.abs(self.robot.parameters)
        if not (alike.all() and (variation >= _LEAST).all() and (variation <= _MOST).all()):
            raise ValueError("a robot's parameters are far from its own")
        if not ((rows["obstacle_seed"] >= 0.0) & (rows["obstacle_seed"] < 1.0)).all():
            raise ValueError("the seed of dynamic obstacles must be in [0, 1)")
        if not np.isin(rows["goal_path"], range(GOALS + 1)).all():
            raise ValueError("a robot has a goal that is not there")

    def draw_worlds(self, draws: Draws) -> int | np.ndarray:
        """Draw a world for each environment; with a single world nothing is drawn.

        Returns:
            The index of the world of all, or of each, shape (num_envs,).
        """
        if self.only is not None or len(self.worlds) == 1:
            return self.only or 0
        return (draws.uniform(1)[:, 0] * len(self.worlds)).astype(int)

    def poses_from(self, worlds: int | np.ndarray, draws: np.ndarray, clearance: float) -> np.ndarray:
        """Poses spread evenly over the free space.

        Args:
            worlds: Index of the world of all, or of each, shape (num_envs,).
            draws: Four random numbers in [0, 1) for each, shape (num_envs, 4).
            clearance: To obstacles and bounds [m].

        Returns:
            x [m], y [m], yaw [rad], shape (num_envs, 3).

        Raises:
            InputError: If the only world has no such free space; that of several was checked before.
        """
        if len(self.worlds) == 1:
            return self.worlds[0].poses_from(draws, clearance)
        return self._places.poses_from(np.broadcast_to(worlds, len(draws)), draws, clearance)
