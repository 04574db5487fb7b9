"""What every task is: settings, and the four things that it defines."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from tb2rl.core.values import Count, Edges, Moved, Name, NonNegative, Observed, Positive, Varied, Worlds
from tb2rl.robots import Robot
from tb2rl.sensors import Sensor
from tb2rl.sensors.laser import LaserRanges
from tb2rl.simulation import Draws, Reading, Setup, Start
from tb2rl.simulation.setup import CROWD
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
    `begin`. All of them work on all robots at once: arrays have a leading robot axis.
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
    noise: NonNegative = 0.0  # [m] standard deviation of the laser; 0.01 is realistic
    variation: Varied = "none"  # of the robot: a preset, or a mapping; see tb2rl/robots/README.md
    movers: Moved = None  # what moves in every world, such as {people: 4}; see tb2rl/worlds/README.md
    frames: Annotated[int, Ge(1), Le(100)] = 1  # the latest so many observations are stacked, the oldest first
    edges: Edges = (0.7, 1.0, 1.7)  # [m] borders of the distance classes
    observe: Observed | None = None  # the sensors, by name: see tb2rl/sensors/README.md; None: the task's own

    @cached_property
    def imperfections(self) -> Variation:
        """What `variation` means.

        Raises:
            InputError: If there is no such preset, or a range does not fit.
        """
        return find_variation(self.variation)

    @property
    def explores(self) -> bool:
        """Whether robots draw maps of what they see, see `Reading.explored`."""
        return False

    @property
    @abstractmethod
    def actions(self) -> Actions:
        """What the robot can be told to do."""

    @abstractmethod
    def judge(self, before: Reading, action: np.ndarray, after: Reading) -> Outcome:
        """Reward and ending of the step that led from one reading to the next.

        Args:
            before, after: Of all robots.
            action: Shape (robots,), or (robots, 2) of `Velocities`.
        """

    def sensors(self, setup: Setup) -> tuple[Sensor, ...]:
        """What a learner observes, in this order."""
        return (LaserRanges(setup.laser, self.edges),)

    def offers(self, setup: Setup) -> tuple[Sensor, ...]:
        """Sensors with the task's settings that `observe` can name, whether or not it observes them by itself."""
        return Task.sensors(self, setup)

    def places(self, worlds: tuple[World, ...], robot: Robot) -> tuple[World, ...]:
        """The worlds as the task sets them: with other goals, say.

        Args:
            worlds: As their files or their generator make them.
            robot: What is to drive there.
        """
        return worlds

    def begin(self, setup: Setup, draws: Draws) -> Start:
        """How the episodes of some robots begin: at the world's start pose, or anywhere in its free space.

        Args:
            setup: The robot, and the worlds to begin in: each robot in one that is drawn for it.
            draws: Random numbers for the robots whose episodes begin.
        """
        worlds = setup.draw_worlds(draws)
        start = Start.proposed(setup, draws.robots, worlds)
        if self.start == "random":
            start.pose[:] = setup.poses_from(worlds, draws.uniform(4), self.start_clearance)
        return start

    def begin_varied(self, setup: Setup, draws: Draws) -> Start:
        """What environments call: `begin`, then the robot's `variation`, and then what decides about movers.

        In this order, and nothing is drawn for nothing: so none of them changes what comes before it.
        """
        start = self.begin(setup, draws)
        self.imperfections.vary(start, draws)
        if setup.anything_moves:
            start.table[:, CROWD] = draws.uniform(1)[:, 0]
        return start
