"""TurtleBot2Maze: keep moving through the world without touching a wall."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tb2rl.simulation import RobotState
from tb2rl.tasks.actions import Commands
from tb2rl.tasks.collision_task import CollisionTask
from tb2rl.tasks.outcome import Outcome, collision_endings


@dataclass(frozen=True)
class Wander(CollisionTask):
    """Forward, left or right; the robot is paid for going straight and fined for coming too close to a wall.

    The actions and rewards are the ones of the ROS tutorial that this project follows; the turn rate is not: at its
    0.3 rad/s a robot that sees a wall at 1 m hardly gets around it.
    """

    forward_speed: float = 0.5  # [m/s]
    turn_speed: float = 0.05  # [m/s] ahead while turning
    turn_rate: float = 1.0  # [rad/s]
    forward_reward: float = 5.0
    turn_reward: float = 1.0

    @cached_property
    def actions(self) -> Commands:
        return Commands(
            forward=(self.forward_speed, 0.0),
            left=(self.turn_speed, self.turn_rate),
            right=(self.turn_speed, -self.turn_rate),
        )

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        collided = self.collided(after)
        moving = np.where(action == self.actions.forward, self.forward_reward, self.turn_reward)
        return Outcome(self.rewards(moving, collided, after), failed=collision_endings(collided, after))
