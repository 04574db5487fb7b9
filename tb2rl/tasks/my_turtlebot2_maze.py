"""An example task, to be copied and changed.

    python -m tb2rl.train --agent qlearn --task my_turtlebot2_maze:MyTurtleBot2Maze

The example adds the action `backward` to `Wander`, with a penalty as large as the reward of `forward`. The fields of a
task are its settings, `actions` is its action space, and `outcome` returns rewards and endings. Arrays have a leading
axis of environments. Derive from `tb2rl.tasks.Task` to start from scratch.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tb2rl.simulation import RobotState
from tb2rl.tasks import Commands, Outcome
from tb2rl.tasks.wander import Wander


@dataclass(frozen=True)
class MyTurtleBot2Maze(Wander):
    """Wander, with a reverse gear whose use is penalised."""

    backward_speed: float = -0.05  # [m/s] speed of the action `backward`
    backward_reward: float = -5.0  # reward of a step backward

    @cached_property
    def actions(self) -> Commands:
        return super().actions.plus(backward=(self.backward_speed, 0.0))  # v [m/s], w [rad/s]

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        outcome = super().outcome(before, action, after)
        backward = (action == self.actions.backward) & ~outcome.terminated
        return replace(outcome, reward=np.where(backward, self.backward_reward, outcome.reward))
