"""What every task is: settings, and the four things that it defines."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from tb2rl.core.values import Bins, Count, Moved, Name, NonNegative, Observed, Parts, Positive, Varied, Worlds
from tb2rl.robots import Robot
from tb2rl.sensors import Sensor
from tb2rl.sensors.laser import LaserRanges
from tb2rl.simulation import Draws, InitialState, RobotState, SimulationSpec
from tb2rl.simulation.variation import Variation, find_variation
from tb2rl.tasks.actions import Actions
from tb2rl.tasks.outcome import Outcome
from tb2rl.worlds import World

Beams = Annotated[int, Ge(1), Le(100_000)]
Clearance = Annotated[Positive, Le(100)]  # [m]
Period = Annotated[float, Gt(0), Le(60)]  # [s]


@dataclass(frozen=True)
class Task(ABC):
    """A task over any simulation and any number of robots.

    Its fields are its settings, for YAML (`task.world: circuit`), the command line (`--set task.world=circuit`) and
    `gymnasium.make(id, world="circuit")` alike. It defines `actions` and `judge`, and where it needs to `sensors` and
    `initial_state`. All of them work on all robots at once: arrays have a leading robot axis.
    """

    goal_task: ClassVar[bool] = False  # whether its episodes succeed at a goal, and not by lasting

    robot: Name = "turtlebot2"  # a built-in name, or "module:ROBOT"
    world: Worlds = "loop"  # or several, or a generator with its settings: see tb2rl/worlds/README.md
    start: Literal["fixed", "random"] = "random"
    start_clearance: Clearance = 0.6  # [m] to walls and the bounds, of a random start
    control_period: Period = 0.2  # [s] an action lasts
    episode_steps: Count = 1500  # control steps until the time limit truncates
    beams: Beams | None = None  # of the laser, ends included; None: the observation's
    field_of_view: Annotated[float, Gt(0), Le(math.tau)] | None = None  # [rad] of the beams; None: the laser's whole
    beam_indices: Annotated[tuple[Annotated[int, Ge(0)], ...], Len(1, 1000)] | None = None  # to read; None: all
    laser_noise: NonNegative = 0.0  # [m] standard deviation of the laser; 0.01 is realistic
    variation: Varied = "none"  # of the robot: a preset, or a mapping; see tb2rl/robots/README.md
    dynamic_obstacles: Moved = None  # what moves in every world, such as {people: 4}; see tb2rl/worlds/README.md
    frame_stack: Annotated[int, Ge(1), Le(100)] = 1  # the latest so many observations are stacked, the oldest first
    range_bins: Bins = (0.7, 1.0, 1.7)  # [m] borders of the distance classes
    observe: Observed | None = None  # the sensors, by name: see tb2rl/sensors/README.md; None: the task's own
    filters: Parts = ()  # of the commands, by name: see tb2rl/tasks/README.md

    @cached_property
    def resolved_variation(self) -> Variation:
        """What `variation` means.

        Raises:
            InputError: If there is no such preset, or a range does not fit.
        """
        return find_variation(self.variation)

    @property
    def maps_online(self) -> bool:
        """Whether robots draw maps of what they see, see `RobotState.occupancy_map`."""
        return False

    @property
    @abstractmethod
    def actions(self) -> Actions:
        """What the robot can be told to do."""

    @abstractmethod
    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        """Reward and ending of the step that led from one reading to the next.

        Args:
            before, after: Of all robots.
            action: Shape (num_envs,), or (num_envs, 2) of `Velocities`.
        """

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        """What a learner observes, in this order."""
        return (LaserRanges(spec.laser, self.range_bins),)

    def available_sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        """Sensors with the task's settings that `observe` can name, whether or not it observes them by itself."""
        return Task.sensors(self, spec)

    def prepare_worlds(self, worlds: tuple[World, ...], robot: Robot) -> tuple[World, ...]:
        """The worlds as the task sets them: with other goals, say.

        Args:
            worlds: As their files or their generator make them.
            robot: What is to drive there.
        """
        return worlds

    def initial_state(self, spec: SimulationSpec, draws: Draws) -> InitialState:
        """How the episodes of some robots begin: at the world's start pose, or anywhere in its free space.

        Args:
            spec: The robot, and the worlds to begin in: each robot in one that is drawn for it.
            draws: Random numbers for the robots whose episodes begin.
        """
        worlds = spec.draw_worlds(draws)
        initial_state = InitialState.default(spec, draws.num_envs, worlds)
        if self.start == "random":
            initial_state.pose[:] = spec.poses_from(worlds, draws.uniform(4), self.start_clearance)
        return initial_state

    def randomized_initial_state(self, spec: SimulationSpec, draws: Draws) -> InitialState:
        """What environments call: `initial_state`, then the robot's `variation`, and then what decides about movers.

        In this order, and nothing is drawn for nothing: so none of them changes what comes before it.
        """
        initial_state = self.initial_state(spec, draws)
        self.resolved_variation.vary(initial_state, draws)
        if spec.has_dynamic_obstacles:
            initial_state.rows["obstacle_seed"] = draws.uniform(1)[:, 0]
        return initial_state
