"""Your own task on the same robot: copy this file, change what you like, and train it.

    python -m tb2rl.train --agent qlearn --task my_task:MyTask

Here: a fourth action, backwards, which costs as much as forwards pays. A task is one class: its fields are its
settings, `commands` are its actions, and `judge` says what a step was worth and whether the episode is over. Both
work on all robots at once, so arrays come with a leading robot axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tb2rl.simulation import Reading
from tb2rl.tasks import Outcome, Task


@dataclass(frozen=True)
class MyTurtleBot2Maze(Task):
    """Forward, left, right or backward; crash-free driving that does not hide in reverse gear."""

    crash_range: float = 0.5  # [m]
    backward_reward: float = -5.0

    @property
    def commands(self) -> np.ndarray:
        return np.array([(0.5, 0.0), (0.05, 1.0), (0.05, -1.0), (-0.05, 0.0)])  # v [m/s], w [rad/s]

    def judge(self, before: Reading, action: np.ndarray, after: Reading) -> Outcome:
        crashed = after.bumped | (after.nearest < self.crash_range)
        worth = np.array([5.0, 1.0, 1.0, self.backward_reward])[action]
        return Outcome(reward=np.where(crashed, -200.0, worth), endings={"crash": crashed})
