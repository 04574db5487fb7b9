"""Features extractors: the first layer of networks that read raw observations."""

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from tb2rl.core.errors import InputError

_TIME_UNIT = np.float32(10.0)  # [s]
MIN_DISTANCE = 0.1  # [m] shorter distances are raised to this one; no built-in laser reads less


class InverseRange(BaseFeaturesExtractor):
    """Encodes a distance d as spread * (1 / (offset + d) - middle), a time in units of 10 s, other numbers in [-1, 1].

    The inverse resolves short distances better. Distances are the numbers of unit "m" with a lower limit of 0 or more,
    see `tb2rl.envs.encodings.SensorBox`. In a plain `Box`, which has no units, the limit alone decides.

    Args:
        observation_space: Space of the raw observations.
        middle: Value of 1 / (offset + d) that becomes 0 [1/m].
        spread: Scale factor [m].
        offset: Added to distances [m]; a small offset emphasises the last decimetres before a wall.

    Raises:
        InputError: If the observations have images.
    """

    _is_distance: th.Tensor
    _largest: th.Tensor

    def __init__(
        self, observation_space: spaces.Box, middle: float = 0.0, spread: float = 1.0, offset: float = 1.0
    ) -> None:
        if not (isinstance(observation_space, spaces.Box) and len(observation_space.shape) == 1):
            raise InputError("InverseRange reads no images; for images use an agent such as stable_baselines3:PPO")
        super().__init__(observation_space, features_dim=int(np.prod(observation_space.shape)))
        self.middle, self.spread, self.offset = middle, spread, offset
        units = getattr(observation_space, "units", ("m",) * observation_space.shape[0])
        distances = [unit == "m" and low >= 0 for unit, low in zip(units, observation_space.low, strict=True)]
        self.register_buffer("_is_distance", th.tensor(distances))
        largest = np.where([unit == "s" for unit in units], _TIME_UNIT, observation_space.high)
        self.register_buffer("_largest", th.as_tensor(largest))

    def forward(self, observations: th.Tensor) -> th.Tensor:
        inverse = self.spread * (1.0 / (self.offset + observations.clamp(min=MIN_DISTANCE)) - self.middle)
        return th.where(self._is_distance, inverse, observations / self._largest)
