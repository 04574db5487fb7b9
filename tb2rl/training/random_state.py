"""Random state of a training: its generators, and exploration noise that is drawn once a rollout."""

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


def generators_state(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """The states of all random generators of a training in this process."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(legacy=False),  # noqa: NPY002 (Stable-Baselines3 draws from it)
        "torch": th.get_rng_state(),
        "actions": algorithm.action_space.np_random.bit_generator.state,
        "own": {name: generator.bit_generator.state for name, generator in _own_generators(algorithm).items()},
    }


def restore_generators(algorithm: BaseAlgorithm, states: Mapping[str, Any]) -> None:
    """Restore the states of all random generators; raises `LIBRARY_ERRORS` if they do not fit."""
    version, words, gauss = states["python"]
    if not 0 <= states["numpy"]["state"]["pos"] <= _WORDS:  # numpy would read outside its state
        raise ValueError("the position of numpy's generator is outside its state")
    random.setstate((version, tuple(words), gauss))
    np.random.set_state(states["numpy"])  # noqa: NPY002
    th.set_rng_state(th.from_numpy(states["torch"]))
    algorithm.action_space.np_random.bit_generator.state = states["actions"]
    for name, generator in _own_generators(algorithm).items():
        generator.bit_generator.state = states["own"][name]


def _own_generators(algorithm: BaseAlgorithm) -> dict[str, np.random.Generator]:
    return {name: value for name, value in vars(algorithm).items() if isinstance(value, np.random.Generator)}


def exploration_matrices(algorithm: BaseAlgorithm) -> list[dict[str, th.Tensor]]:
    """The matrices of generalized state-dependent exploration (Raffin et al. 2022), if the algorithm uses it."""
    return [{name: getattr(noise, name) for name in _MATRICES} for noise in _noises(algorithm)]


def _noises(algorithm: BaseAlgorithm) -> list[StateDependentNoiseDistribution]:
    distributions = (getattr(module, "action_dist", None) for module in algorithm.policy.modules())
    return [noise for noise in distributions if isinstance(noise, StateDependentNoiseDistribution)]


class RestoreRandomState(BaseCallback):
    """Restores generators and exploration matrices where the first rollout starts.

    Stable-Baselines3 draws the matrices just before `on_rollout_start`, where checkpoints are taken: a resumed training
    has drawn once too often.

    Args:
        algorithm: The learner.
        generators: See `generators_state`.
        matrices: See `exploration_matrices`, as arrays; None: the checkpoint was taken after the last rollout, and
            nothing is restored.
    """

    def __init__(self, algorithm: BaseAlgorithm, generators: Mapping[str, Any], matrices: Any) -> None:
        super().__init__()
        self._generators, self._pending = generators, matrices is not None
        self._matrices = [
            (noise, {name: th.from_numpy(saved[name]).to(algorithm.device) for name in _MATRICES})
            for noise, saved in zip(_noises(algorithm), matrices or [], strict=self._pending)
        ]

    def _on_rollout_start(self) -> None:
        if self._pending:
            self._pending = False
            restore_generators(self.model, self._generators)
            for noise, matrices in self._matrices:
                for name, matrix in matrices.items():
                    setattr(noise, name, matrix)

    def _on_step(self) -> bool:
        return True
