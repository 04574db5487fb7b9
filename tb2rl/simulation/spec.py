"""What a simulation is made of."""

from __future__ import annotations

import math
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
_UNDIVIDED = 0.7  # [m/s] a robot that is faster has its steps divided, see `SimulationSpec.substeps`

# The columns of a table of starts, which the compiled kernels read: one row for each robot.
POSE, WORLD, GOAL, BOUNDS, PARAMETERS, VARIATION = (
    slice(0, 3),
    3,
    slice(4, 6),
    slice(6, 10),
    slice(10, 16),
    slice(16, 31),
)
CROWD = 31  # number in [0, 1) that decides all that movers do in the episode; see `tb2rl.simulation.dynamic_obstacles`
WAY = 32  # number of the goal among those of its world that ways are known to, see `tb2rl.worlds.goal_paths`
COLUMNS = WAY + 1
# The flaws, which `tb2rl.simulation.variation` draws:
WHEEL = 16  # true radius of the wheels / the radius that the robot counts with
ASSUMED_SEPARATION = 17  # wheel separation that the robot counts with / the true one
LEFT_COUNT, RIGHT_COUNT = 18, 19  # way that the encoder of a wheel counts / the way that the wheel went
WHEELS = slice(16, 20)  # these four
NOISE = 20  # [m] standard deviation of the laser; below 0: that of `Laser.noise`
BIAS = 21  # [m] added to all ranges
DROPPED = 22  # share of the laser's beams that come back empty
MOUNT = slice(23, 26)  # x [m], y [m], yaw [rad]: where the laser is, beside where it should be
MASS, FRICTION = 26, 27  # of the robot and of its wheels on the floor / its own; in PyBullet alone
COMMAND_LATENCY, OBSERVATION_LATENCY = 28, 29  # [control steps]
GYRO = 30  # turn that the gyro counts / the true one; 0: there is none, and odometry turns as its wheels count
_LARGEST_VARIATION = 10.0  # of a robot's parameters, times its own
_LEAST = np.array([0.5, 0.5, 0.5, 0.5, -1.0, -1.0, 0.0, -0.5, -0.5, -np.pi, 0.1, 0.01, 0.0, 0.0, 0.0])
_MOST = np.array([2.0, 2.0, 2.0, 2.0, np.inf, 1.0, 1.0, 0.5, 0.5, np.pi, 10.0, 10.0, 10.0, 10.0, 2.0])


@dataclass(frozen=True, eq=False)
class SimulationSpec:
    """A robot, the laser that it reads, and the worlds that its episodes can be in.

    Attributes:
        robot: What drives.
        laser: The robot's laser with the beams and the noise that the task asks for.
        worlds: At least one; a `InitialState` names one by its index.
        only: Index of the one world that episodes begin in; None: any of them.
        dynamic_obstacles: What moves in every world, beside what each world has itself.
    """

    robot: Robot
    laser: Laser
    worlds: tuple[World, ...]
    only: int | None = None
    dynamic_obstacles: tuple[DynamicObstacles, ...] = ()

    @cached_property
    def table(self) -> np.ndarray:
        """The start that each world proposes, a row of columns as above for each, shape (worlds, 33)."""
        table = np.empty((len(self.worlds), COLUMNS))
        for number, world in enumerate(self.worlds):
            table[number, POSE] = world.start
            table[number, WORLD] = number
            table[number, GOAL] = world.goal[:2] if world.goal else np.nan
            table[number, BOUNDS] = world.bounds
        table[:, PARAMETERS] = self.robot.parameters
        table[:, VARIATION], table[:, CROWD], table[:, WAY] = 0.0, 0.0, OWN
        table[:, WHEELS], table[:, [MASS, FRICTION]] = 1.0, 1.0
        table[:, NOISE], table[:, GYRO] = -1.0, float(self.robot.gyro)
        return table

    @cached_property
    def substeps(self) -> int:
        """Into how many parts PyBullet divides each step of the physics: a fast robot would get far into a wall in one.

        A power of two, so that Bullet, which counts the parts by a clock, never has one too few.
        """
        return 2 ** max(0, math.ceil(math.log2(self.robot.max_speed / _UNDIVIDED)))

    def dynamic_obstacles_in(self, world: int) -> tuple[DynamicObstacles, ...]:
        """What moves in the world with this index."""
        return (*self.dynamic_obstacles, *self.worlds[world].dynamic_obstacles)

    def without_dynamic_obstacles(self) -> SimulationSpec:
        """The same robot in the same worlds, where nothing moves."""
        worlds = tuple(
            replace(world, dynamic_obstacles=()) if world.dynamic_obstacles else world for world in self.worlds
        )
        return replace(self, dynamic_obstacles=(), worlds=worlds)

    @cached_property
    def has_dynamic_obstacles(self) -> bool:
        """Whether there are movers in any of the worlds."""
        return bool(self.dynamic_obstacles) or any(world.dynamic_obstacles for world in self.worlds)

    @cached_property
    def ways(self) -> GoalPaths:
        """The ways to goals in these worlds."""
        return GoalPaths(self.worlds, self.robot.radius)

    @cached_property
    def _places(self) -> Places:
        return Places(self.worlds, self.robot.radius)

    def within(self, world: int) -> SimulationSpec:
        """The setup whose episodes begin in the world with this index alone."""
        spec = replace(self, only=world)
        vars(spec).update(
            {name: getattr(self, name) for name in ("table", "ways", "_places", "has_dynamic_obstacles")}
        )  # which are the same
        return spec

    def check_table(self, table: np.ndarray) -> None:
        """Raise a `ValueError` for a table of starts, from a file, whose robots or worlds cannot be of this setup."""
        if not np.isin(table[:, WORLD], range(len(self.worlds))).all():
            raise ValueError("a robot is in a world that is not there")
        flaws, parameters = table[:, VARIATION], np.abs(table[:, PARAMETERS])
        alike = parameters <= _LARGEST_VARIATION * np.abs(self.robot.parameters)
        if not (alike.all() and (flaws >= _LEAST).all() and (flaws <= _MOST).all()):
            raise ValueError("a robot's parameters are far from what it is")
        if not ((table[:, CROWD] >= 0.0) & (table[:, CROWD] < 1.0)).all():
            raise ValueError("what decides about movers must be a number in [0, 1)")
        if not np.isin(table[:, WAY], range(GOALS + 1)).all():
            raise ValueError("a robot has a goal that is not there")

    def draw_worlds(self, draws: Draws) -> int | np.ndarray:
        """The world that each robot begins in: a number of its own decides where there are several.

        Returns:
            The index of the world of all, or of each one's, shape (num_envs,).
        """
        if self.only is not None or len(self.worlds) == 1:
            return self.only or 0
        return (draws.uniform(1)[:, 0] * len(self.worlds)).astype(int)

    def poses_from(self, worlds: int | np.ndarray, draws: np.ndarray, clearance: float) -> np.ndarray:
        """Poses spread evenly over where robots can begin.

        Args:
            worlds: Index of the world of all, or of each one's, shape (num_envs,).
            draws: Four random numbers in [0, 1) for each, shape (num_envs, 4).
            clearance: To obstacles and bounds [m].

        Returns:
            x [m], y [m], yaw [rad], shape (num_envs, 3).

        Raises:
            InputError: If the start of the only world has no such clearance; that of several is known to have it.
        """
        if len(self.worlds) == 1:
            return self.worlds[0].poses_from(draws, clearance)
        return self._places.poses_from(np.broadcast_to(worlds, len(draws)), draws, clearance)
