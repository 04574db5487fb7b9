"""TurtleBot2Wall: reach a pose behind a wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tb2rl.core.values import Edges, Point, Positive, Worlds
from tb2rl.sensors import Sensor
from tb2rl.sensors.goal import BEARING_EDGES, DISTANCE_EDGES, GoalBearing, GoalDistance
from tb2rl.simulation import Draws, Reading, Setup, Start
from tb2rl.tasks.outcome import Outcome
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.world import Bounds


@dataclass(frozen=True)
class ReachGoal(Wander):
    """Wander's actions and rewards, more for each step that comes closer, and an end at the goal.

    Beside the laser, the robot observes where the goal is in its own frame, by its wheels' odometry.
    """

    goal_task: ClassVar[bool] = True

    world: Worlds = "wall"
    goal: Point | None = None  # [m] x and y; None: the world's own goal
    goal_tolerance: Positive = 0.2  # [m] in x and in y
    closer_reward: float = 5.0  # on top of the step's reward
    goal_reward: float = 200.0  # replaces the step's reward
    bounds: Bounds | None = None  # x from, y from, x to, y to [m]; None: the world's
    distance_edges: Edges = DISTANCE_EDGES  # [m]
    bearing_edges: Edges = BEARING_EDGES  # [rad]

    def sensors(self, setup: Setup) -> tuple[Sensor, ...]:
        return (*super().sensors(setup), GoalDistance(self.distance_edges), GoalBearing(self.bearing_edges))

    def begin(self, setup: Setup, draws: Draws) -> Start:
        start = super().begin(setup, draws)
        if self.goal is not None:
            start.goal[:] = self.goal
        if self.bounds is not None:
            start.bounds[:] = self.bounds
        return start

    def judge(self, before: Reading, action: np.ndarray, after: Reading) -> Outcome:
        wandered = super().judge(before, action, after)
        missing = after.goal - after.pose[:, :2]
        reached = np.logical_and(*(np.abs(missing) <= self.goal_tolerance).T)
        x, y = after.pose[:, 0], after.pose[:, 1]
        x0, y0, x1, y1 = after.start.bounds.T
        outside: np.ndarray = (x <= x0) | (x > x1) | (y <= y0) | (y > y1)
        closer = np.hypot(*missing.T) < np.hypot(*(after.goal - before.pose[:, :2]).T)
        moving = wandered.reward + self.closer_reward * closer
        crashed = wandered.terminated
        reward = np.select([crashed | outside, reached], [self.crash_reward, self.goal_reward], moving)
        return Outcome(reward, failed={**wandered.failed, "out of bounds": outside}, succeeded={"goal": reached})
