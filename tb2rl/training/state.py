"""Capture and restore the state of a training, so that a resumed training is identical to the last bit.

The state is captured between rollouts, when the on-policy buffer has no data to keep. This module uses private
attributes of Stable-Baselines3, which has no public interface to the state of an algorithm.
"""

import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.distributions import StateDependentNoiseDistribution
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import unwrap_vec_normalize

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.encodings import take_rows
from tb2rl.runs import LIBRARY_ERRORS, is_training_state, parameters_of, restore_like

_NOT_SAVED = {  # attributes of this process, or set by `tb2rl.runs.loading.load_parameters` or by `restore`
    "verbose", "start_time", "_total_timesteps", "_num_timesteps_at_start", "tensorboard_log", "n_envs",
    "num_timesteps", "_last_original_obs",
}  # fmt: skip
_MERSENNE_TWISTER_WORDS = 624  # size of the state of numpy's legacy generator
_EXPLORATION_MATRICES = ("exploration_mat", "exploration_matrices")  # attributes of StateDependentNoiseDistribution


class StatefulCallback(BaseCallback):
    """A callback with attributes that are part of a checkpoint.

    Attributes:
        saved_attributes: Names of these attributes. Their values are numbers, or collections of numbers.
    """

    saved_attributes: ClassVar[tuple[str, ...]]

    def state(self) -> dict[str, Any]:
        """The values of the saved attributes, by name without leading underscores."""
        return {name.lstrip("_"): getattr(self, name) for name in self.saved_attributes}

    def restore(self, state: Mapping[str, Any]) -> None:
        values = restore_like(self.state(), state, type(self).__name__)
        for name in self.saved_attributes:
            setattr(self, name, values[name.lstrip("_")])


def capture(algorithm: BaseAlgorithm, callbacks: CallbackList, at_rollout_start: bool) -> dict[str, Any]:
    """Capture the state of a training, except the policy's parameters, as a tree for `write_checkpoint`.

    If a rollout has just started (`at_rollout_start`), the state includes the sampled exploration noise.
    """
    assert algorithm.env is not None
    buffer = getattr(algorithm, "replay_buffer", None)
    matrices = [{name: getattr(noise, name) for name in _EXPLORATION_MATRICES} for noise in _distributions(algorithm)]
    return {
        **parameters_of(algorithm),
        "algorithm": _attributes(algorithm),
        "replay_buffer": None if buffer is None else _slice_slots(_attributes(buffer), buffer, buffer.size()),
        "generators": _generators_state(algorithm),
        "noise": matrices if at_rollout_start else None,
        "environments": _environments_state(algorithm.env),
        "callbacks": [callback.state() for callback in _stateful_callbacks(callbacks)],
    }


def restore(state: Mapping[str, Any], algorithm: BaseAlgorithm, callbacks: CallbackList, file: Path) -> None:
    """Restore a captured state into a new training, except learned parameters, which `load_parameters` restores.

    A new callback is inserted before the others; it restores random states again at the start of the first rollout.

    Raises:
        InputError: If the names, shapes or types of the state in `file` differ from those of this training.
    """
    assert algorithm.env is not None
    try:
        _set_up(algorithm)
        for name, value in restore_like(_attributes(algorithm), state["algorithm"], "algorithm").items():
            setattr(algorithm, name, value)
        if state["replay_buffer"] is not None:
            _refill(algorithm.replay_buffer, state["replay_buffer"])  # type: ignore[attr-defined]
        _restore_environments(algorithm.env, state["environments"])
        last_obs = algorithm._last_obs
        if (vec_normalize := algorithm.get_vec_normalize_env()) is not None:
            last_obs = algorithm._last_original_obs = vec_normalize.get_original_obs()
            algorithm._last_obs = vec_normalize.normalize_obs(last_obs)
        for i in range(algorithm.env.num_envs):
            if not algorithm.observation_space.contains(take_rows(last_obs, i)):
                raise ValueError("the last observation lies outside the observation space")
        for callback, saved in zip(_stateful_callbacks(callbacks), state["callbacks"], strict=True):
            callback.restore(saved)
        _restore_generators(algorithm, state["generators"])
        callbacks.callbacks.insert(0, _RestoreRandomState(algorithm, state["generators"], state["noise"]))
    except LIBRARY_ERRORS as error:
        raise InputError(one_line(f"{file}: the state of the training is damaged: {error!r}")) from None


def _stateful_callbacks(callbacks: CallbackList) -> list[StatefulCallback]:
    return [callback for callback in callbacks.callbacks if isinstance(callback, StatefulCallback)]


# ---- the algorithm


def _set_up(algorithm: BaseAlgorithm) -> None:
    """Set up an algorithm as `learn` would, so that it has all attributes to restore."""
    algorithm.set_logger(Logger(None, []))  # else Stable-Baselines3 creates a temporary folder for a logger
    vec_normalize = algorithm.get_vec_normalize_env()
    if vec_normalize is not None:
        vec_normalize.training = False  # else the env reset would update the statistics that `load_parameters` restored
    algorithm._setup_learn(0, reset_num_timesteps=False)
    if vec_normalize is not None:
        vec_normalize.training = True


def _attributes(owner: Any) -> dict[str, Any]:
    """The attributes of an algorithm or a buffer that belong in a checkpoint, found by their types.

    There is no fixed list, because the algorithm may be a class of any package.
    """
    return {
        name: value
        for name, value in vars(owner).items()
        if is_training_state(value) and name not in _NOT_SAVED and not getattr(value, "requires_grad", False)
    }


# ---- the replay buffer, of which a checkpoint contains only the filled slots


def _slice_slots(value: Any, buffer: BaseBuffer, num_slots: int) -> Any:
    """Slice the arrays of a buffer's attributes to the first `num_slots` slots; other values are unchanged."""
    if isinstance(value, Mapping):
        return {name: _slice_slots(part, buffer, num_slots) for name, part in value.items()}
    has_slots = isinstance(value, np.ndarray) and value.ndim > 0 and len(value) == buffer.buffer_size
    return value[:num_slots] if has_slots else value


def _refill(buffer: BaseBuffer, saved: Mapping[str, Any]) -> None:
    present = _slice_slots(_attributes(buffer), buffer, buffer.buffer_size if saved["full"] else saved["pos"])
    for name, value in restore_like(present, saved, "replay_buffer").items():
        if not isinstance(value, np.ndarray | Mapping):  # arrays were restored in place, because slices are views
            setattr(buffer, name, value)


# ---- the environments


def _environments_state(env: Any) -> dict[str, Any]:
    """The state of all environments, and the returns and last observations of `VecNormalize`."""
    state = {"loop": env.unwrapped.loop.state()}
    if (vec_normalize := unwrap_vec_normalize(env)) is not None:
        state |= {"returns": vec_normalize.returns.copy(), "old_obs": vec_normalize.get_original_obs()}
    return state


def _restore_environments(env: Any, saved: Any) -> None:
    state = restore_like(_environments_state(env), saved, "environments")
    env.unwrapped.loop.restore(state.pop("loop"))
    if state:
        vars(unwrap_vec_normalize(env)).update(state)


# ---- random generators, and exploration noise that is sampled once per rollout


def _generators_state(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """The states of all random generators of a training in this process."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(legacy=False),  # noqa: NPY002 (Stable-Baselines3 draws from it)
        "torch": th.get_rng_state(),
        "sb3": {name: generator.bit_generator.state for name, generator in _sb3_generators(algorithm).items()},
    }


def _restore_generators(algorithm: BaseAlgorithm, states: Mapping[str, Any]) -> None:
    """Restore the states of all random generators; raises one of `LIBRARY_ERRORS` if a state is invalid."""
    version, words, gauss = states["python"]
    if not 0 <= states["numpy"]["state"]["pos"] <= _MERSENNE_TWISTER_WORDS:  # numpy does not check the range
        raise ValueError("the position of numpy's generator is out of range")
    random.setstate((version, tuple(words), gauss))
    np.random.set_state(states["numpy"])  # noqa: NPY002
    th.set_rng_state(th.from_numpy(states["torch"]))
    for name, generator in _sb3_generators(algorithm).items():
        generator.bit_generator.state = states["sb3"][name]


def _sb3_generators(algorithm: BaseAlgorithm) -> dict[str, np.random.Generator]:
    candidates = {"actions": algorithm.action_space.np_random, **vars(algorithm)}
    return {name: value for name, value in candidates.items() if isinstance(value, np.random.Generator)}


def _distributions(algorithm: BaseAlgorithm) -> list[StateDependentNoiseDistribution]:
    """The distributions of generalized state-dependent exploration (Raffin et al. 2022), if the algorithm uses this."""
    distributions = (getattr(module, "action_dist", None) for module in algorithm.policy.modules())
    return [noise for noise in distributions if isinstance(noise, StateDependentNoiseDistribution)]


class _RestoreRandomState(BaseCallback):
    """Restores generators and exploration matrices at the start of the first rollout.

    Checkpoints are saved in `on_rollout_start`, just after Stable-Baselines3 has sampled the matrices. A resumed
    training starts this rollout again, and samples them a second time. A checkpoint from the end of a training has
    None instead of a list of matrices; then this callback does nothing.
    """

    def __init__(self, algorithm: BaseAlgorithm, generators: Mapping[str, Any], saved_matrices: Any) -> None:
        super().__init__()
        self._generators, self._pending = generators, saved_matrices is not None
        self._matrices = [
            (noise, {name: th.from_numpy(saved[name]).to(algorithm.device) for name in _EXPLORATION_MATRICES})
            for noise, saved in zip(_distributions(algorithm), saved_matrices or [], strict=self._pending)
        ]

    def _on_rollout_start(self) -> None:
        if self._pending:
            self._pending = False
            _restore_generators(self.model, self._generators)
            for noise, matrices in self._matrices:
                vars(noise).update(matrices)

    def _on_step(self) -> bool:
        return True
