"""Your own task on the same robot: copy this file, change what you like, and train it.

    python -m tb2rl.train --agent qlearn --task my_turtlebot2_maze:MyTurtleBot2Maze

Here: a fourth action, backwards, which costs as much as forwards pays. A task is one class: its fields are its
settings, `commands` are its actions, and `judge` says what a step was worth and whether the episode is over. Both
work on all robots at once, so arrays come with a leading robot axis. Derive from `Task` to start from nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tb2rl.simulation import Reading
from tb2rl.tasks import Outcome
from tb2rl.tasks.wander import Wander


@dataclass(frozen=True)
class MyTurtleBot2Maze(Wander):
    """Wander, with a reverse gear that it does not pay to hide in."""

    BACKWARD: ClassVar[int] = 3

    backward_speed: float = -0.05  # [m/s]
    backward_reward: float = -5.0

    @property
    def commands(self) -> np.ndarray:
        return np.vstack([super().commands, (self.backward_speed, 0.0)])  # rows of v [m/s], w [rad/s]

    def judge(self, before: Reading, action: np.ndarray, after: Reading) -> Outcome:
        outcome = super().judge(before, action, after)
        backward = (action == self.BACKWARD) & ~outcome.terminated
        return replace(outcome, reward=np.where(backward, self.backward_reward, outcome.reward))
