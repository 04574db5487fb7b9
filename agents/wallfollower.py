"""Wall following, a rule-based baseline."""

import math
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl import Agent
from tb2rl.core.errors import InputError

AGENT = Agent(algorithm=None, policy="tb2rl.agents.wallfollower:WallFollower", fixed_obs_mode=True)

FORWARD, LEFT, RIGHT = 0, 1, 2
ACTION_SPEEDS = th.tensor([[0.5, 0.0], [-0.85, 0.5], [-0.85, -0.5]])  # of forward, left, right; v = -1: standstill


class WallFollower(BasePolicy):
    """Follows the wall on its right at a constant distance, which two beams measure.

    Args:
        observation_space: `tb2rl.envs.encodings.SensorBox` that begins with five or more ranges from -90 to 90 degrees.
        action_space: Named actions that begin with forward, left, right; or v, w from -1 to 1; v = -1 is standstill.
        side: Distance to keep from the wall [m].
        ahead: Free distance to keep ahead [m].
        guard: Distance to keep from obstacles to the left and right [m]; the robot turns away from nearer ones.
        tolerance: Tolerance of `side` [m].
        lost: A wall farther than `side` + `lost` is ignored [m].
        look_ahead: Distance ahead of the robot at which the distance of the wall is predicted [m].
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        side: float = 0.8,
        ahead: float = 0.85,
        guard: float = 0.6,
        tolerance: float = 0.15,
        lost: float = 1.0,
        look_ahead: float = 0.4,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, **kwargs)
        self._frame_stack = getattr(observation_space, "frame_stack", 1)
        beams = sum(name == "laser" for name in getattr(observation_space, "names", ())) // self._frame_stack
        if beams < 5:
            raise InputError(f"the wall follower needs at least 5 beams over 180 degrees, got {beams}")
        self.side, self.ahead, self.guard = side, ahead, guard
        self.tolerance, self.lost, self.look_ahead = tolerance, lost, look_ahead
        self._beams, angles = beams, th.linspace(-90.0, 90.0, beams)
        self._oblique = int((angles + 45.0).abs().argmin())
        self._beam_angle = math.radians(float(angles[self._oblique] - angles[0]))  # [rad] from the beam at -90 degrees
        self._right, self._front, self._left = angles < -25.0, angles.abs() <= 25.0, angles > 25.0

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        latest = observation[:, -observation.shape[1] // self._frame_stack :]
        ranges = latest[:, : self._beams]
        side_range, oblique = ranges[:, 0], ranges[:, self._oblique]
        # Angle between wall and heading, positive if the wall recedes ahead; from both ranges and `_beam_angle`.
        angle = th.atan2(oblique * math.cos(self._beam_angle) - side_range, oblique * math.sin(self._beam_angle))
        distance = side_range * th.cos(angle) + self.look_ahead * th.sin(angle)
        right, front, left = (ranges[:, part].amin(dim=1) for part in (self._right, self._front, self._left))

        action = th.full((len(observation),), FORWARD)
        action[(distance > self.side + self.tolerance) & (distance < self.side + self.lost)] = RIGHT
        action[distance < self.side - self.tolerance] = LEFT
        action[left < self.guard] = RIGHT
        action[(front < self.ahead) | (right < self.guard)] = LEFT
        return action if isinstance(self.action_space, spaces.Discrete) else ACTION_SPEEDS[action]
