"""Where the randomness of a training comes from: generators of five kinds, and noise that is drawn once a rollout."""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.distributions import StateDependentNoiseDistribution

_WORDS = 624  # of the Mersenne Twister's state
_MATRICES = ("exploration_mat", "exploration_matrices")  # of Stable-Baselines3's state-dependent noise


def generators_of(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """The states of all generators that a training in this process draws from."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(legacy=False),  # noqa: NPY002 (Stable-Baselines3 draws from it)
        "torch": th.get_rng_state(),
        "actions": algorithm.action_space.np_random.bit_generator.state,
        "own": {name: generator.bit_generator.state for name, generator in _own(algorithm).items()},
    }


def set_generators(algorithm: BaseAlgorithm, states: Mapping[str, Any]) -> None:
    """Put the states of all generators back.

    Raises:
        ValueError, TypeError, KeyError: If they are not what `generators_of` gave.
    """
    kind, numbers, gauss = states["python"]
    if not 0 <= states["numpy"]["state"]["pos"] <= _WORDS:  # numpy would read there
        raise ValueError("the position of numpy's generator is outside its state")
    random.setstate((kind, tuple(numbers), gauss))
    np.random.set_state(states["numpy"])  # noqa: NPY002
    th.set_rng_state(th.from_numpy(states["torch"]))
    algorithm.action_space.np_random.bit_generator.state = states["actions"]
    for name, generator in _own(algorithm).items():
        generator.bit_generator.state = states["own"][name]


def _own(algorithm: BaseAlgorithm) -> dict[str, np.random.Generator]:
    return {name: value for name, value in vars(algorithm).items() if isinstance(value, np.random.Generator)}


def noise_of(algorithm: BaseAlgorithm) -> list[dict[str, th.Tensor]]:
    """The exploration matrices of generalised state-dependent exploration (Raffin et al. 2022), if it is used."""
    return [{name: getattr(noise, name) for name in _MATRICES} for noise in _noises(algorithm)]


def _noises(algorithm: BaseAlgorithm) -> list[StateDependentNoiseDistribution]:
    distributions = (getattr(module, "action_dist", None) for module in algorithm.policy.modules())
    return [noise for noise in distributions if isinstance(noise, StateDependentNoiseDistribution)]


class PutBack(BaseCallback):
    """Puts what was random back where the first rollout starts.

    Stable-Baselines3 draws exploration matrices just before it says that a rollout starts, where a checkpoint is taken:
    in a resumed training it has drawn them once too often.

    Args:
        algorithm: What learns.
        generators: As `generators_of` gave them.
        noise: As `noise_of` gave it, arrays for tensors; None: the checkpoint was not taken where a rollout starts, and
            there is nothing to put back.

    Raises:
        ValueError, TypeError, KeyError: If the noise is not that of such an algorithm.
    """

    def __init__(self, algorithm: BaseAlgorithm, generators: Mapping[str, Any], noise: Any) -> None:
        super().__init__()
        self._generators, self._first = generators, noise is not None
        self._noise = [
            (mine, {name: th.from_numpy(theirs[name]).to(algorithm.device) for name in _MATRICES})
            for mine, theirs in zip(_noises(algorithm), noise or [], strict=self._first)
        ]

    def _on_rollout_start(self) -> None:
        if self._first:
            self._first = False
            set_generators(self.model, self._generators)
            for distribution, matrices in self._noise:
                for name, matrix in matrices.items():
                    setattr(distribution, name, matrix)

    def _on_step(self) -> bool:
        return True
