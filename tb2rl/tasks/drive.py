"""TurtleBot2Drive: wander at any speed, paid for the distance driven."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tb2rl.core.values import NonNegative, Positive
from tb2rl.simulation import RobotState
from tb2rl.tasks.actions import Velocities
from tb2rl.tasks.collision_task import CollisionTask
from tb2rl.tasks.outcome import Outcome, collision_endings

_HALF = 0.3  # [rad/s] where half of `turn_cost` is lost; in a circle of 2 m around its middle, at full speed


@dataclass(frozen=True)
class Drive(CollisionTask):
    """Drive as far as possible without coming too close to a wall.

    A step is worth v cos(w) dt, the metres driven, less the more the robot turns (Xie et al. 2017, "Towards Monocular
    Vision based Obstacle Avoidance through Deep Reinforcement Learning"). So a circle on one spot, half a metre around
    its middle, pays a quarter of what the same speed pays straight on. A crash costs a fifth of theirs, for it ends the
    pay as well: with -10 the first thing that td3 learns is to stand, and it stays at that.

    That leaves a wide circle nearly as good as anything else. With a `turn_cost`, a robot that turns sharply now and
    then gets more than one that turns a little all the time, so it sees more of a world.
    """

    max_speed: Positive = 0.65  # [m/s] the slowest is to stand
    turn_rate: Positive = 2.0  # [rad/s] to both sides
    collision_reward: float = -2.0  # as much as 2 m pay
    turn_cost: NonNegative = 0.0  # what turning takes of the pay at most, as a share: half of it at 0.3 rad/s

    @cached_property
    def actions(self) -> Velocities:
        return Velocities(forward=(0.0, self.max_speed), turn=(-self.turn_rate, self.turn_rate))

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        collided = self.collided(after)
        v, w = after.twist.T  # what the robot does, not what it was told
        driven = v * np.cos(w) * self.control_period
        if self.turn_cost:
            driven = driven - self.turn_cost * v * np.abs(w) / (np.abs(w) + _HALF) * self.control_period
        return Outcome(self.rewards(driven, collided, after), failed=collision_endings(collided, after))
