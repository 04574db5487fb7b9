"""TurtleBot2Drive: drive as far as possible at any speed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tb2rl.core.values import NonNegative, Positive
from tb2rl.simulation import RobotState
from tb2rl.tasks.actions import Velocities
from tb2rl.tasks.outcome import Outcome
from tb2rl.tasks.task import CollisionTask

_HALF_RATE = 0.3  # [rad/s] at which half of `turn_cost` applies: a circle of 2 m radius at full speed


@dataclass(frozen=True)
class Drive(CollisionTask):
    """Drive as far as possible without a collision.

    The reward of a step is v cos(w) dt, the distance driven, reduced by turns (Xie et al. 2017, "Towards Monocular
    Vision based Obstacle Avoidance through Deep Reinforcement Learning"). At full speed a circle of 0.5 m radius earns
    a quarter of a straight line. The collision reward is a fifth of theirs, because a collision also ends the rewards:
    with -10 td3 learns to stand still.

    A wide circle still earns nearly as much as anything else. A `turn_cost` favours few sharp turns over constant
    slight ones, so the robot explores more of the world.
    """

    max_speed: Positive = 0.65  # [m/s]; the least is 0
    turn_rate: Positive = 2.0  # [rad/s] to both sides
    collision_reward: float = -2.0  # the reward of 2 m
    turn_cost: NonNegative = 0.0  # largest share of the reward that a turn costs; half of it at 0.3 rad/s

    @cached_property
    def actions(self) -> Velocities:
        return Velocities(forward=(0.0, self.max_speed), turn=(-self.turn_rate, self.turn_rate))

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        v, w = after.twist.T  # the actual motion, not the command
        driven = v * np.cos(w) * self.control_period
        if self.turn_cost:
            driven = driven - self.turn_cost * v * np.abs(w) / (np.abs(w) + _HALF_RATE) * self.control_period
        return self.collision_outcome(driven, after)
