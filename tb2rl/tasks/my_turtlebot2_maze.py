"""Your own task on the same robot: copy this file, change what you like, and train it.

    python -m tb2rl.train --agent qlearn --task my_turtlebot2_maze:MyTurtleBot2Maze

Here: a fourth action, backwards, which costs as much as forwards pays. A task is one class: its fields are its
settings, `actions` says what the robot can be told, and `judge` what a step was worth and whether the episode is over.
Both work on all robots at once, so arrays come with a leading robot axis. Derive from `tb2rl.tasks.Task` to start from
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tb2rl.simulation import RobotState
from tb2rl.tasks import Commands, Outcome
from tb2rl.tasks.wander import Wander


@dataclass(frozen=True)
class MyTurtleBot2Maze(Wander):
    """Wander, with a reverse gear that it does not pay to hide in."""

    backward_speed: float = -0.05  # [m/s]
    backward_reward: float = -5.0

    @cached_property
    def actions(self) -> Commands:
        return super().actions.plus(backward=(self.backward_speed, 0.0))  # v [m/s], w [rad/s]

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        outcome = super().outcome(before, action, after)
        backward = (action == self.actions.backward) & ~outcome.terminated
        return replace(outcome, reward=np.where(backward, self.backward_reward, outcome.reward))
