"""TurtleBot2Wall: reach a pose behind a wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tb2rl.core.values import Bins, Point, Positive, Worlds
from tb2rl.sensors import Sensor
from tb2rl.sensors.goal import BEARING_BINS, DISTANCE_BINS, GoalBearing, GoalDistance
from tb2rl.simulation import Draws, InitialState, RobotState, SimulationSpec
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
    progress_reward: float = 5.0  # on top of the step's reward
    goal_reward: float = 200.0  # replaces the step's reward
    bounds: Bounds | None = None  # x from, y from, x to, y to [m]; None: the world's
    distance_bins: Bins = DISTANCE_BINS  # [m]
    bearing_bins: Bins = BEARING_BINS  # [rad]

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        return (*super().sensors(spec), GoalDistance(self.distance_bins), GoalBearing(self.bearing_bins))

    def initial_state(self, spec: SimulationSpec, draws: Draws) -> InitialState:
        initial_state = super().initial_state(spec, draws)
        if self.goal is not None:
            initial_state.goal[:] = self.goal
        if self.bounds is not None:
            initial_state.bounds[:] = self.bounds
        return initial_state

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        wandered = super().outcome(before, action, after)
        missing = after.goal - after.pose[:, :2]
        reached = np.logical_and(*(np.abs(missing) <= self.goal_tolerance).T)
        x, y = after.pose[:, 0], after.pose[:, 1]
        x0, y0, x1, y1 = after.initial_state.bounds.T
        outside: np.ndarray = (x <= x0) | (x > x1) | (y <= y0) | (y > y1)
        closer = np.hypot(*missing.T) < np.hypot(*(after.goal - before.pose[:, :2]).T)
        moving = wandered.reward + self.progress_reward * closer
        collided = wandered.terminated
        reward = np.select([collided | outside, reached], [self.collision_reward, self.goal_reward], moving)
        return Outcome(reward, failed={**wandered.failed, "out of bounds": outside}, succeeded={"goal": reached})
