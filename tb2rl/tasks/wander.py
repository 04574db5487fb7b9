"""TurtleBot2Maze: keep moving without a collision."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tb2rl.simulation import RobotState
from tb2rl.tasks.actions import Commands
from tb2rl.tasks.task import CollisionTask, Outcome


@dataclass(frozen=True)
class Wander(CollisionTask):
    """Move forward, left or right; going straight earns more than turning, and a collision is penalised.

    Actions and rewards are those of the ROS tutorial that this project follows, except for the turn rate. At the
    tutorial's 0.3 rad/s a turn of 90 degrees takes 26 control steps.
    """

    forward_speed: float = 0.5  # [m/s] speed of the action `forward`
    turn_speed: float = 0.05  # [m/s] forward speed while turning
    turn_rate: float = 1.0  # [rad/s] turn rate of the actions `left` and `right`
    forward_reward: float = 5.0  # reward of a step forward
    turn_reward: float = 1.0  # reward of a step with a turn

    @cached_property
    def actions(self) -> Commands:
        v, w = self.turn_speed, self.turn_rate
        return Commands(forward=(self.forward_speed, 0.0), left=(v, w), right=(v, -w))

    def outcome(self, before: RobotState, action: np.ndarray, after: RobotState) -> Outcome:
        reward = np.where(action == self.actions.forward, self.forward_reward, self.turn_reward)
        return self.collision_outcome(reward, after)
