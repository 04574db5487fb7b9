"""What tasks share in which a robot must not come too close to a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tb2rl.simulation import Reading
from tb2rl.tasks.task import Task
from tb2rl.values import NonNegative


@dataclass(frozen=True)
class Crashing(Task):
    """A task whose episodes end in a crash; what else counts is for the tasks to say that derive from it."""

    crash_reward: float = -200.0  # replaces the step's reward
    crash_range: NonNegative = 0.5  # [m] a range below this is a crash; so is any touch of the bumper

    def crashed(self, after: Reading) -> np.ndarray:
        """Which robots have crashed, bool, shape (robots,)."""
        return after.bumped | (after.nearest < self.crash_range)
