"""What tasks share in which a robot must not come too close to a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tb2rl.core.values import NonNegative
from tb2rl.simulation import RobotState
from tb2rl.tasks.task import Task


@dataclass(frozen=True)
class CollisionTask(Task):
    """A task whose episodes end in a crash; what else counts is for the tasks to say that derive from it."""

    collision_reward: float = -200.0  # replaces the step's reward
    collision_range: NonNegative = 0.5  # [m] a range below this is a crash; so is any touch of the bumper
    margin: NonNegative = 0.0  # [m] between robot and wall, below which a step is fined
    margin_reward: float = 0.0  # the fine at a touch; farther away it falls to 0 by its square

    def collided(self, after: RobotState) -> np.ndarray:
        """Which robots have crashed, bool, shape (num_envs,)."""
        return after.bumped | (after.nearest < self.collision_range)

    def rewards(self, earned: np.ndarray, collided: np.ndarray, after: RobotState) -> np.ndarray:
        """What robots get that earned so much, less the fine, shape (num_envs,); of a crash, `collision_reward`
        alone.
        """
        if self.margin:
            gap = after.nearest - after.initial_state.rows["radius"]
            earned = earned + self.margin_reward * (np.clip(self.margin - gap, 0.0, self.margin) / self.margin) ** 2
        return np.where(collided, self.collision_reward, earned)
