"""Base class of tasks that end in a collision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tb2rl.core.values import NonNegative
from tb2rl.simulation import RobotState
from tb2rl.tasks.outcome import Outcome, collision_endings
from tb2rl.tasks.task import Task


@dataclass(frozen=True)
class CollisionTask(Task):
    """A task whose episodes end in a collision: a contact, or a range below `collision_range`."""

    collision_reward: float = -200.0  # replaces the step's reward
    collision_range: NonNegative = 0.5  # [m]
    margin: NonNegative = 0.0  # [m] gap between robot and wall, below which a step is penalised
    margin_reward: float = 0.0  # the penalty at contact; it falls to 0 by the square of the gap

    def collision_outcome(self, reward: np.ndarray, after: RobotState) -> Outcome:
        """The outcome of steps with these rewards, shape (num_envs,), but for penalties and collisions."""
        collided = after.bumped | (after.nearest < self.collision_range)
        if self.margin:
            gap = after.nearest - after.initial_state.rows["radius"]
            reward = reward + self.margin_reward * (np.clip(self.margin - gap, 0.0, self.margin) / self.margin) ** 2
        reward = np.where(collided, self.collision_reward, reward)
        return Outcome(reward, failed=collision_endings(collided, after))
