"""TurtleBot2Drive: drive as far as possible at any speed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tb2rl.core.values import NonNegative, Positive
from tb2rl.simulation import RobotState
from tb2rl.tasks.actions import Velocities
from tb2rl.tasks.task import CollisionTask, Outcome

_HALF_COST_RATE = 0.3  # [rad/s] turn rate that costs half of `turn_cost`; at 0.65 m/s a circle of 2 m radius


@dataclass(frozen=True)
class Drive(CollisionTask):
    """Drive as far as possible without a collision.

    The reward of a step is v cos(w) dt, so turns earn less than straight lines (Xie et al. 2017, "Towards Monocular
    Vision based Obstacle Avoidance through Deep Reinforcement Learning"). At full speed a circle of 0.5 m radius earns
    a quarter of a straight line. The collision reward is a fifth of the paper's -10, with which td3 learns to stand
    still.

    A wide circle earns nearly as much as a straight line. With `turn_cost`, few sharp turns earn more than constant
    slight turns, so that the robot explores more of the world.
    """

    max_speed: Positive = 0.65  # [m/s] largest forward speed; the lowest is 0
    turn_rate: Positive = 2.0  # [rad/s] largest turn rate to both sides
    collision_reward: float = -2.0  # replaces the step's reward; minus the reward of 2 m straight ahead
    turn_cost: NonNegative = 0.0  # share of v dt lost in the sharpest turns; at 0.3 rad/s half of this share

    @cached_property
    def actions(self) -> Velocities:
        return Velocities(forward=(0.0, self.max_speed), turn=(-self.turn_rate, self.turn_rate))

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        v, w = after.twist.T  # the actual motion, not the command
        reward = v * np.cos(w) * self.control_period
        if self.turn_cost:
            reward = reward - self.turn_cost * v * np.abs(w) / (np.abs(w) + _HALF_COST_RATE) * self.control_period
        return self.collision_outcome(reward, after)
