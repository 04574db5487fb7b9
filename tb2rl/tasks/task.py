"""Base classes of tasks."""

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
from tb2rl.tasks.outcome import Outcome, collision_endings
from tb2rl.worlds import World

Beams = Annotated[int, Ge(1), Le(100_000)]
Clearance = Annotated[Positive, Le(100)]  # [m]
Period = Annotated[float, Gt(0), Le(60)]  # [s]


@dataclass(frozen=True)
class Task(ABC):
    """A task in any simulator, for any number of environments.

    Its fields are settings, for YAML (`task.world: circuit`), `--set task.world=circuit` and
    `gymnasium.make(id, world="circuit")`. It defines `actions` and `outcome`, and overrides `sensors` and
    `initial_state` if needed. Arrays have a leading axis of environments.
    """

    goal_task: ClassVar[bool] = False  # whether an episode succeeds at a goal, not at the time limit

    robot: Name = "turtlebot2"  # a built-in name, or "module:ROBOT"
    world: Worlds = "loop"  # a name, several, or a generator with its settings: see tb2rl/worlds/README.md
    start: Literal["fixed", "random"] = "random"
    start_clearance: Clearance = 0.6  # [m] from a random start to walls and bounds
    control_period: Period = 0.2  # [s]
    episode_steps: Count = 1500  # [control steps] the time limit
    beams: Beams | None = None  # of the laser, both ends included; None: the default of the observation
    field_of_view: Annotated[float, Gt(0), Le(math.tau)] | None = None  # [rad]; None: all of the laser's
    beam_indices: Annotated[tuple[Annotated[int, Ge(0)], ...], Len(1, 1000)] | None = None  # selected beams; None: all
    laser_noise: NonNegative = 0.0  # [m] standard deviation; 0.01 is realistic
    variation: Varied = "none"  # a preset, or ranges by name: see tb2rl/robots/README.md
    dynamic_obstacles: Moved = None  # in every world, such as {people: 4}: see tb2rl/worlds/README.md
    frame_stack: Annotated[int, Ge(1), Le(100)] = 1  # number of stacked observations, the oldest first
    range_bins: Bins = (0.7, 1.0, 1.7)  # [m] borders of the range bins
    observe: Observed | None = None  # sensors by name: see tb2rl/sensors/README.md; None: `sensors`
    filters: Parts = ()  # of commands, by name: see tb2rl/tasks/README.md

    @cached_property
    def resolved_variation(self) -> Variation:
        """The ranges that `variation` names; an `InputError` if it does not fit."""
        return find_variation(self.variation)

    @property
    def maps_online(self) -> bool:
        """Whether robots map their surroundings online, see `RobotState.occupancy_map`."""
        return False

    @property
    @abstractmethod
    def actions(self) -> Actions:
        """The action space."""

    @abstractmethod
    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        """Rewards and endings of a step.

        Args:
            before, after: State of all robots before and after the step.
            action: Shape (num_envs,), or (num_envs, 2) for `Velocities`.
        """

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        """The observation: sensors in this order."""
        return (LaserRanges(spec.laser, self.range_bins),)

    def available_sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        """Sensors that have the task's settings when `observe` names them, beside those of `sensors`."""
        return Task.sensors(self, spec)

    def prepare_worlds(self, worlds: tuple[World, ...], robot: Robot) -> tuple[World, ...]:
        """The worlds of the task, such as `worlds` with other goals."""
        return worlds

    def initial_state(self, spec: SimulationSpec, draws: Draws) -> InitialState:
        """Initial states of new episodes: in a random world of `spec`, at a random pose or at the world's start."""
        worlds = spec.draw_worlds(draws)
        initial_state = InitialState.default(spec, draws.num_envs, worlds)
        if self.start == "random":
            initial_state.pose[:] = spec.poses_from(worlds, draws.uniform(4), self.start_clearance)
        return initial_state

    def randomized_initial_state(self, spec: SimulationSpec, draws: Draws) -> InitialState:
        """Draw the initial state, then the `variation` of the robot, then the seed of dynamic obstacles.

        In this order none changes the draws before it; nothing is drawn for a part that is absent.
        """
        initial_state = self.initial_state(spec, draws)
        self.resolved_variation.vary(initial_state, draws)
        if spec.has_dynamic_obstacles:
            initial_state.rows["obstacle_seed"] = draws.uniform(1)[:, 0]
        return initial_state


@dataclass(frozen=True)
class CollisionTask(Task):
    """A task whose episodes end in a collision: a contact, or a range below `collision_range`."""

    collision_reward: float = -200.0  # replaces the step's reward
    collision_range: NonNegative = 0.5  # [m]
    margin: NonNegative = 0.0  # [m] gap between robot and wall, below which a step is penalised
    margin_reward: float = 0.0  # the penalty at contact; it falls to 0 by the square of the gap

    def collision_outcome(self, reward: np.ndarray, after: RobotState) -> Outcome:
        """The outcome of a step: `reward`, shape (num_envs,), reduced near walls and replaced at a collision."""
        collided = after.bumped | (after.nearest < self.collision_range)
        if self.margin:
            gap = after.nearest - after.initial_state.rows["radius"]
            reward = reward + self.margin_reward * (np.clip(self.margin - gap, 0.0, self.margin) / self.margin) ** 2
        reward = np.where(collided, self.collision_reward, reward)
        return Outcome(reward, failed=collision_endings(collided, after))
