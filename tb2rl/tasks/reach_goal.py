"""TurtleBot2Wall: reach a pose behind a wall."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from tb2rl.errors import InputError
from tb2rl.maze import Maze
from tb2rl.settings import Edges, Point, Positive
from tb2rl.simulation import Reading
from tb2rl.tasks import Outcome, Sense
from tb2rl.tasks.wander import Wander


@dataclass(frozen=True)
class ReachGoal(Wander):
    """Wander's actions and rewards, more for each step that comes closer, and an end at the goal.

    Beside the laser, the robot observes where the goal is in its own frame, by its wheels' odometry.
    """

    goal_task: ClassVar[bool] = True

    maze: str = "wall"
    goal: Point | None = None  # [m] x and y; None: the maze's own goal
    goal_tolerance: Positive = 0.2  # [m] in x and in y
    closer_reward: float = 5.0  # on top of the step's reward
    goal_reward: float = 200.0  # replaces the step's reward
    bounds: tuple[float, float, float, float] | None = None  # x from, y from, x to, y to [m]; None: the maze's
    distance_edges: Edges = (0.3, 0.6, 1.0, 2.0, 3.5)  # [m]
    bearing_edges: Edges = (-2.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0)  # [rad]

    def placed(self, maze: Maze) -> Self:
        goal = self.goal or (maze.goal and maze.goal[:2])
        if goal is None:
            raise InputError(f"maze {maze.name} has no goal; set task.goal to [x, y], or a goal in the maze's file")
        return replace(self, goal=goal, bounds=self.bounds or maze.bounds)

    @property
    def senses(self) -> tuple[Sense, ...]:
        return (
            Sense("goal distance", 0.0, 100.0, self.distance_edges),
            Sense("goal bearing", -math.pi, math.pi, self.bearing_edges),
        )

    def sense(self, reading: Reading) -> np.ndarray:
        east, north = (self.goal - reading.odometry[:, :2]).T
        bearing = np.arctan2(north, east) - reading.odometry[:, 2]
        return np.column_stack([np.hypot(east, north), np.remainder(bearing + math.pi, math.tau) - math.pi])

    def judge(self, before: Reading, action: np.ndarray, after: Reading) -> Outcome:
        wandered = super().judge(before, action, after)
        missing = self.goal - after.pose[:, :2]
        reached = np.logical_and(*(np.abs(missing) <= self.goal_tolerance).T)
        x0, y0, x1, y1 = self.bounds or (-np.inf, -np.inf, np.inf, np.inf)
        x, y = after.pose[:, 0], after.pose[:, 1]
        outside: np.ndarray = (x <= x0) | (x > x1) | (y <= y0) | (y > y1)
        closer = np.hypot(*missing.T) < np.hypot(*(self.goal - before.pose[:, :2]).T)
        moving = wandered.reward + self.closer_reward * closer
        crashed = wandered.endings["crash"]
        reward = np.select([crashed | outside, reached], [self.crash_reward, self.goal_reward], moving)
        endings: dict[str, np.ndarray] = {"crash": crashed, "out of bounds": outside, "goal": reached}
        return Outcome(reward, endings, success=reached & ~crashed & ~outside)
