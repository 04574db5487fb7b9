"""Drive ahead until something is near, turn away from it until the way is free: what a learner should beat."""

from __future__ import annotations

from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.errors import InputError
from tb2rl.registry import Agent

AGENT = Agent(algorithm=None, policy="tb2rl.agents.wallfollower:WallFollower", observation="raw", only=True)

FORWARD, LEFT, RIGHT = 0, 1, 2


class WallFollower(BasePolicy):
    """Keeps the wall to its right at a distance, by a rule for each beam that reads less than it should.

    Args:
        observation_space: Ranges of beams from -90 to +90 degrees.
        action_space: Forward, left, right.
        side: Distance to keep at the side [m].
        ahead: Free way to keep ahead [m].
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Discrete,
        side: float = 0.9,
        ahead: float = 1.1,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, **kwargs)
        beams = observation_space.shape[0]
        if beams < 5:
            raise InputError(f"the wall follower needs at least 5 beams over 180 degrees, got {beams}")
        self.side, self.ahead = side, ahead
        angles = th.linspace(-90.0, 90.0, beams)
        self._right = angles < -30.0
        self._front = angles.abs() <= 30.0
        self._left = angles > 30.0

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        right = observation[:, self._right].amin(dim=1)
        front = observation[:, self._front].amin(dim=1)
        left = observation[:, self._left].amin(dim=1)
        blocked = front < self.ahead
        squeezed = right < 0.65
        wide = (right > self.side) & (left > 0.65)
        action = th.full((len(observation),), FORWARD)
        action[wide] = RIGHT
        action[left < 0.65] = RIGHT
        action[blocked | squeezed] = LEFT
        return action
