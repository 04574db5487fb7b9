"""TurtleBot2Maze: keep moving through the maze without touching a wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tb2rl.settings import NonNegative
from tb2rl.simulation import Reading
from tb2rl.tasks import Outcome, Task


@dataclass(frozen=True)
class Wander(Task):
    """Forward, left or right; the robot is paid for going straight and fined for coming too close to a wall.

    The actions and rewards are the ones of the ROS tutorial that this project follows; the turn rate is not: at its
    0.3 rad/s a robot that sees a wall at 1 m hardly gets around it.
    """

    FORWARD: ClassVar[int] = 0
    LEFT: ClassVar[int] = 1
    RIGHT: ClassVar[int] = 2

    forward_speed: float = 0.5  # [m/s]
    turn_speed: float = 0.05  # [m/s] ahead while turning
    turn_rate: float = 1.0  # [rad/s]
    forward_reward: float = 5.0
    turn_reward: float = 1.0
    crash_reward: float = -200.0  # replaces the step's reward
    crash_range: NonNegative = 0.5  # [m] a kept reading below this is a crash; so is any touch of the bumper

    @property
    def commands(self) -> np.ndarray:
        return np.array(
            [(self.forward_speed, 0.0), (self.turn_speed, self.turn_rate), (self.turn_speed, -self.turn_rate)]
        )

    def judge(self, before: Reading, action: np.ndarray, after: Reading) -> Outcome:
        crashed = after.bumped | (after.nearest < self.crash_range)
        moving = np.where(action == self.FORWARD, self.forward_reward, self.turn_reward)
        return Outcome(np.where(crashed, self.crash_reward, moving), {"crash": crashed})
