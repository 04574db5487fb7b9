"""TurtleBot2Wall: reach a goal behind a wall."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tb2rl.core.values import Bins, Point, Positive, Worlds
from tb2rl.sensors import Sensor
from tb2rl.sensors.goal import BEARING_BINS, DISTANCE_BINS, GoalBearing, GoalDistance
from tb2rl.simulation import InitialState, RandomSource, RobotState, SimulationSpec
from tb2rl.tasks.task import Outcome
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.world import Bounds


@dataclass(frozen=True)
class ReachGoal(Wander):
    """Wander's actions and rewards, a bonus for each step towards the goal, and success at the goal.

    The robot observes its laser, and the distance and bearing of the goal by odometry.
    """

    goal_task: ClassVar[bool] = True

    world: Worlds = "wall"
    goal: Point | None = None  # x, y [m]; None: the world's goal
    goal_tolerance: Positive = 0.2  # [m] the goal is reached if its offsets in x and y are at most this
    progress_reward: float = 5.0  # added to the reward of a step towards the goal
    goal_reward: float = 200.0  # replaces the reward of the step
    bounds: Bounds | None = None  # min x, min y, max x, max y [m]; outside is a failure; None: the world's bounds
    distance_bins: Bins = DISTANCE_BINS  # [m] borders between bins of the goal's distance
    bearing_bins: Bins = BEARING_BINS  # [rad] borders between bins of the goal's bearing

    def sensors(self, spec: SimulationSpec) -> tuple[Sensor, ...]:
        return (*super().sensors(spec), GoalDistance(self.distance_bins), GoalBearing(self.bearing_bins))

    def initial_state(self, spec: SimulationSpec, random: RandomSource) -> InitialState:
        initial_state = super().initial_state(spec, random)
        if self.goal is not None:
            initial_state.goal[:] = self.goal
        if self.bounds is not None:
            initial_state.bounds[:] = self.bounds
        return initial_state

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        wander_outcome = super().outcome(before, action, after)
        x, y = after.pose[:, :2].T
        min_x, min_y, max_x, max_y = after.initial_state.bounds.T
        outside: np.ndarray = (x <= min_x) | (x > max_x) | (y <= min_y) | (y > max_y)
        offset, last_offset = after.goal - after.pose[:, :2], after.goal - before.pose[:, :2]
        reached = (np.abs(offset) <= self.goal_tolerance).all(axis=1)
        moving_reward = wander_outcome.reward + self.progress_reward * (np.hypot(*offset.T) < np.hypot(*last_offset.T))
        failed = wander_outcome.terminated | outside
        reward = np.select([failed, reached], [self.collision_reward, self.goal_reward], moving_reward)
        return Outcome(reward, {**wander_outcome.failed, "out of bounds": outside}, succeeded={"goal": reached})
