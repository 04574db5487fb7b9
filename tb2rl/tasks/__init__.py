"""What a robot is asked to do: actions, reward and ending, over any simulation and any number of robots.

A task is a frozen dataclass; its fields are its settings, for YAML (`task.maze: circuit`), the command line
(`--set task.maze=circuit`) and `gymnasium.make(id, maze="circuit")` alike. `my_turtlebot2_maze.py` is the one to copy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from tb2rl import robot
from tb2rl.maze import Maze
from tb2rl.settings import Count, Edges, NonNegative
from tb2rl.simulation import Reading


@dataclass(frozen=True)
class Outcome:
    """What a task makes of one control step.

    Attributes:
        reward: Shape (robots,).
        endings: Why episodes end here, each reason with its robots, bool, shape (robots,); earlier ones win.
        success: Whether the goal was reached, bool, shape (robots,); None for a task without a goal.
    """

    reward: np.ndarray
    endings: Mapping[str, np.ndarray] = field(default_factory=dict)
    success: np.ndarray | None = None

    @property
    def terminated(self) -> np.ndarray:
        """Whether an episode ends here, bool, shape (robots,)."""
        return (
            np.logical_or.reduce(list(self.endings.values()))
            if self.endings
            else np.zeros(len(self.reward), dtype=bool)
        )

    def ending(self, robot: int, timed_out: bool) -> str | None:
        """Why the episode of a robot is over, None if it is not; `timed_out` says that its steps are used up."""
        for reason, where in self.endings.items():
            if where[robot]:
                return reason
        return "time limit" if timed_out else None

    def succeeded(self, robot: int, ending: str | None) -> bool:
        """Whether a robot reached the goal; without one, whether it got to the time limit."""
        return bool(self.success[robot]) if self.success is not None else ending == "time limit"


@dataclass(frozen=True)
class Sense:
    """One number that a task observes beside the laser, for example how far the goal is."""

    name: str
    low: float
    high: float
    edges: tuple[float, ...]  # borders of its classes for tabular learners


@dataclass(frozen=True)
class Task(ABC):
    """The settings that all tasks share, and the three things that a task defines: commands, judge, and its senses."""

    goal_task: ClassVar[bool] = False  # whether `Outcome.success` means anything

    maze: str = "loop"  # a built-in name, or the path of a YAML file or a text drawing
    start: Literal["fixed", "random"] = "random"
    start_clearance: Annotated[float, Ge(robot.BASE_RADIUS), Le(100)] = (
        0.6  # [m] to walls and the bounds, of a random start
    )
    control_period: Annotated[float, Gt(0), Le(60)] = 0.2  # [s] an action lasts
    episode_steps: Count = 1500  # control steps until the time limit truncates
    beams: Annotated[int, Ge(1), Le(100_000)] | None = None  # over 180 degrees, ends included; None: the observation's
    kept: Annotated[tuple[Annotated[int, Ge(0)], ...], Len(1, 1000)] | None = None  # beams to read; None: all
    noise: NonNegative = 0.0  # [m] standard deviation of the laser; `robot.LASER_NOISE` is realistic
    edges: Edges = (0.7, 1.0, 1.7)  # [m] borders of the distance classes

    @property
    @abstractmethod
    def commands(self) -> np.ndarray:
        """What each action tells the base: v [m/s] and w [rad/s], shape (actions, 2)."""

    @abstractmethod
    def judge(self, before: Reading, action: np.ndarray, after: Reading) -> Outcome:
        """Reward and ending of the step that led from one reading to the next; action has shape (robots,)."""

    @property
    def senses(self) -> tuple[Sense, ...]:
        """What is observed beside the laser."""
        return ()

    def sense(self, reading: Reading) -> np.ndarray:
        """The values of `senses`, shape (robots, senses)."""
        return np.empty((len(reading.pose), 0))

    def placed(self, maze: Maze) -> Self:
        """This task with what it leaves to its maze filled in, such as the goal."""
        return self

    def laser(self, beams: int) -> robot.Laser:
        """The laser that the task reads; `beams` where it sets no number itself."""
        return robot.Laser(beams=self.beams or beams, kept=self.kept, noise=self.noise)
