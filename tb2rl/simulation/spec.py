"""Specification of a simulator, and initial states of its episodes."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tb2rl.robots import Laser, Robot
from tb2rl.simulation.random_streams import RandomSource
from tb2rl.worlds import World
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.floor import PoseSampler
from tb2rl.worlds.goal_paths import OWN_GOAL, RANDOM_GOALS, GoalPaths
from tb2rl.worlds.spatial_index import SpatialIndex, join_indices

PHYSICS_RATE = 80.0  # [Hz] of physics steps; at 60 Hz robots penetrate walls by 9 mm, 100 Hz takes a third more time
_MAX_PARAMETER = 1e3  # limit of the absolute values of robot parameters in a state from a file
_MAX_SPEED_WITHOUT_SUBSTEPS = 0.7  # [m/s] faster robots would penetrate walls without substeps of the physics

# Columns of the table of initial states, which has a row for each environment. Compiled code reads a row as a record.
FIELDS = (
    "x", "y", "yaw",  # [m, m, rad]
    "world",  # index in `SimulationSpec.worlds`
    "goal_x", "goal_y",  # [m]
    "min_x", "min_y", "max_x", "max_y",  # [m] bounds of the world
    # Fields of `Robot`; the separation and the motors are those of the varied robot, not nominal:
    "radius", "wheel_separation", "max_speed", "max_turn_rate", "wheel_acceleration", "wheel_coupling",
    # Other parameters drawn by `tb2rl.simulation.variation`:
    "wheel_radius",  # true / nominal
    "assumed_separation",  # wheel separation assumed by the odometry / true wheel separation
    "left_encoder", "right_encoder",  # distance measured by an encoder / true distance, if the wheel radius is nominal
    "laser_noise",  # [m] standard deviation; negative: `Laser.noise`
    "bias",  # [m] added to all ranges
    "dropped",  # share of beams that return inf
    "mount_x", "mount_y", "mount_yaw",  # [m, m, rad] true pose of the laser in its nominal frame
    "mass", "friction",  # true / nominal, of the robot and of its wheels on the floor
    "command_latency", "observation_latency",  # [control steps]
    "gyro",  # turn measured by the gyro / true turn; 0: no gyro, the heading comes from the encoders
    # The episode:
    "obstacle_seed",  # in [0, 1), key of all random numbers of the dynamic obstacles
    "goal_path",  # number of the goal in `SimulationSpec.goal_paths`, if the goal has paths there
)  # fmt: skip
RECORD = np.dtype([(name, np.float64) for name in FIELDS])
POSE, GOAL, BOUNDS, PARAMETERS = slice(0, 3), slice(4, 6), slice(6, 10), slice(10, 16)


@dataclass(frozen=True, eq=False)
class SimulationSpec:
    """A robot, its laser, and the worlds of its episodes."""

    robot: Robot
    laser: Laser  # the robot's laser, with the beams and the noise of the task
    worlds: tuple[World, ...]  # at least one world; an `InitialState` refers to a world by its index
    only_world: int | None = None  # index of the only world in which episodes start; None: episodes start in all worlds
    dynamic_obstacles: tuple[DynamicObstacles, ...] = ()  # in every world, in addition to `World.dynamic_obstacles`

    @cached_property
    def table(self) -> np.ndarray:
        """The default initial state in each world, shape (worlds, len(FIELDS))."""
        table = np.zeros((len(self.worlds), len(FIELDS)))
        for index, world in enumerate(self.worlds):
            table[index, POSE], table[index, BOUNDS] = world.start, world.bounds
            table[index, GOAL] = world.goal[:2] if world.goal else np.nan
        table[:, PARAMETERS] = [getattr(self.robot, name) for name in FIELDS[PARAMETERS]]
        records = InitialState(table).records
        records["world"], records["goal_path"] = np.arange(len(self.worlds)), OWN_GOAL
        for ratio in ("wheel_radius", "assumed_separation", "left_encoder", "right_encoder", "mass", "friction"):
            records[ratio] = 1.0
        records["laser_noise"], records["gyro"] = -1.0, float(self.robot.gyro)
        return table

    @cached_property
    def substeps(self) -> int:
        """Number of substeps of a physics step; without substeps, a fast robot would penetrate walls.

        A power of two, because otherwise rounding errors of Bullet's clock could omit a substep.
        """
        return 2 ** max(0, math.ceil(math.log2(self.robot.max_speed / _MAX_SPEED_WITHOUT_SUBSTEPS)))

    def dynamic_obstacles_in(self, world: int) -> tuple[DynamicObstacles, ...]:
        """The dynamic obstacles of the world with this index."""
        return (*self.dynamic_obstacles, *self.worlds[world].dynamic_obstacles)

    def without_dynamic_obstacles(self) -> SimulationSpec:
        """The same robot and worlds, without dynamic obstacles."""
        worlds = (replace(world, dynamic_obstacles=()) if world.dynamic_obstacles else world for world in self.worlds)
        return replace(self, dynamic_obstacles=(), worlds=tuple(worlds))

    @cached_property
    def has_dynamic_obstacles(self) -> bool:
        """Whether any of the worlds has dynamic obstacles."""
        return bool(self.dynamic_obstacles) or any(world.dynamic_obstacles for world in self.worlds)

    @cached_property
    def spatial_index(self) -> SpatialIndex:
        """The obstacles of all worlds, for compiled code."""
        return join_indices([world.spatial_index for world in self.worlds])

    @cached_property
    def goal_paths(self) -> GoalPaths:
        return GoalPaths(self.worlds, self.robot.radius)

    @cached_property
    def _pose_sampler(self) -> PoseSampler:
        return PoseSampler(self.worlds, self.robot.radius)

    def for_world(self, world: int) -> SimulationSpec:
        """Copy the spec for episodes that start in the world with this index only; expensive properties are shared."""
        _ = self.table, self.goal_paths, self._pose_sampler  # computed here, so that all copies share them
        spec = copy(self)
        object.__setattr__(spec, "only_world", world)
        return spec

    def check_table(self, table: np.ndarray) -> None:
        """Raise a `ValueError` if a table of initial states from a file has values that could make a step endless."""
        rows, parameters = InitialState(table).records, table[:, PARAMETERS.start :]  # these and all later columns
        known = np.isin(rows["world"], range(len(self.worlds))) & np.isin(rows["goal_path"], range(RANDOM_GOALS + 1))
        if not (known.all() and (np.abs(parameters) < _MAX_PARAMETER).all()):
            raise ValueError("an initial state has an unknown world or goal, or impossible parameters")

    def draw_worlds(self, random: RandomSource) -> int | np.ndarray:
        """Draw the index of the world of each environment, shape (num_envs,).

        If only one world is possible, the result is its index, without a draw.
        """
        if self.only_world is not None or len(self.worlds) == 1:
            return self.only_world or 0
        return (random.uniform(1)[:, 0] * len(self.worlds)).astype(int)

    def sample_poses(self, worlds: int | np.ndarray, random_numbers: np.ndarray, clearance: float) -> np.ndarray:
        """Sample poses x [m], y [m], yaw [rad] uniformly in the free space, shape (num_envs, 3).

        Args:
            worlds: Index of the world of all environments, or of each environment, shape (num_envs,).
            random_numbers: Uniform in [0, 1), shape (num_envs, 4).
            clearance: Minimum distance to obstacles and bounds [m]; with several worlds, each start must have it.

        Raises:
            InputError: If the spec has one world, and no such free space in it.
        """
        if len(self.worlds) == 1:
            return self.worlds[0].sample_poses(random_numbers, clearance)
        worlds = np.broadcast_to(worlds, len(random_numbers))
        return self._pose_sampler.sample_poses(worlds, random_numbers, clearance)


@dataclass(frozen=True)
class InitialState:
    """Pose, world, goal and robot parameters of each environment at the start of an episode.

    A task takes `default` and overwrites values: `initial_state.goal[:] = (1.0, 2.0)`. All properties are views.

    Attributes:
        table: Columns of `FIELDS`, shape (num_envs, len(FIELDS)).
    """

    table: np.ndarray

    @classmethod
    def default(cls, spec: SimulationSpec, num_envs: int, world: int | np.ndarray = 0) -> InitialState:
        """Start pose, goal and bounds of a world, and parameters of the nominal robot.

        `world` is the index of the world of all environments, or of each environment, shape (num_envs,).
        """
        return cls(spec.table.take(np.full(num_envs, world), axis=0))

    @cached_property
    def records(self) -> np.ndarray:
        """The table as records, shape (num_envs,), such as `initial_state.records["mass"] = 1.2`."""
        return self.table.view(RECORD)[:, 0]

    def __getstate__(self) -> dict[str, Any]:  # without the cached view, which a copy would separate from the table
        return {"table": self.table}

    @property
    def pose(self) -> np.ndarray:
        """X [m], y [m], yaw [rad], shape (num_envs, 3)."""
        return self.table[:, POSE]

    @property
    def world(self) -> np.ndarray:
        """Index into `SimulationSpec.worlds`, shape (num_envs,), as floats."""
        return self.records["world"]

    @property
    def goal(self) -> np.ndarray:
        """X and y [m], shape (num_envs, 2); NaN without a goal."""
        return self.table[:, GOAL]

    @property
    def bounds(self) -> np.ndarray:
        """Rectangle of the world: min x, min y, max x, max y [m], shape (num_envs, 4)."""
        return self.table[:, BOUNDS]
