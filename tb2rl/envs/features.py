"""Features extractors: preprocessing of raw observations in networks."""

from __future__ import annotations

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from tb2rl.core.errors import InputError

NEAREST = 0.1  # [m] smaller distances count as this; below the laser's shortest range


class InverseRange(BaseFeaturesExtractor):
    """Distances d as 1 / (offset + d), which resolves short ones better; other numbers scaled to [-1, 1].

    Distances are the numbers of unit "m" (see `tb2rl.envs.encodings.SensorBox`) that cannot be below 0. A plain `Box`
    has no units, so there all numbers that cannot be below 0 are distances.

    Args:
        observation_space: Raw observations.
        middle: Inverse range that becomes 0.
        spread: Factor on the difference to it.
        offset: [m]; if it is small, the last decimetres before a wall stand out.

    Raises:
        InputError: If there are images among the observations.
    """

    _is_distance: th.Tensor
    _largest: th.Tensor

    def __init__(
        self, observation_space: spaces.Box, middle: float = 0.0, spread: float = 1.0, offset: float = 1.0
    ) -> None:
        if not (isinstance(observation_space, spaces.Box) and len(observation_space.shape) == 1):
            raise InputError("InverseRange reads numbers alone; for images take, say, agent stable_baselines3:PPO")
        super().__init__(observation_space, features_dim=int(np.prod(observation_space.shape)))
        self.middle, self.spread, self.offset = middle, spread, offset
        units = getattr(observation_space, "units", ("m",) * observation_space.shape[0])
        distances = [unit == "m" and low >= 0 for unit, low in zip(units, observation_space.low, strict=True)]
        self.register_buffer("_is_distance", th.tensor(distances))
        self.register_buffer("_largest", th.as_tensor(observation_space.high))

    def forward(self, observations: th.Tensor) -> th.Tensor:
        inverse = self.spread * (1.0 / (self.offset + observations.clamp(min=NEAREST)) - self.middle)
        return th.where(self._is_distance, inverse, observations / self._largest)
