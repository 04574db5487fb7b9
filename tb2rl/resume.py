"""Everything that the rest of a training depends on, taken and put back: so that a resumed one goes on to the bit.

Taken where a rollout starts: there an on-policy buffer is empty, and what has been collected has been learned from.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.vec_env import VecEnv

from tb2rl.errors import InputError
from tb2rl.vec_env import BatchVecEnv

_OF_THE_PROCESS = {"verbose", "start_time", "_total_timesteps", "_num_timesteps_at_start", "tensorboard_log", "n_envs"}


class Stateful(Protocol):
    """A callback that remembers."""

    def state(self) -> Mapping[str, Any]:
        """What it remembers, in plain values."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Remember that instead."""


def capture(algorithm: BaseAlgorithm, callbacks: Sequence[Stateful]) -> dict[str, Any]:
    """The state of a training as a tree for `checkpoint.write_checkpoint`."""
    assert algorithm.env is not None
    buffer = getattr(algorithm, "replay_buffer", None)
    return {
        "optimizers": {key: value for key, value in algorithm.get_parameters().items() if key != "policy"},
        "algorithm": _plain_attributes(algorithm),
        "replay_buffer": _filled(buffer) if isinstance(buffer, BaseBuffer) else None,
        "generators": _generators(algorithm),
        "worlds": worlds_state(algorithm.env),
        "callbacks": [dict(callback.state()) for callback in callbacks],
    }


def restore(state: Mapping[str, Any], algorithm: BaseAlgorithm, callbacks: Sequence[Stateful]) -> None:
    """Put a captured state back; the policy's parameters are the caller's.

    Raises:
        InputError: If it does not fit this training.
    """
    assert algorithm.env is not None
    try:
        _set_plain_attributes(algorithm, state["algorithm"])
        if state["replay_buffer"] is not None:
            _refill(algorithm.replay_buffer, state["replay_buffer"])  # type: ignore[attr-defined]
        restore_worlds(algorithm.env, state["worlds"])
        for callback, remembered in zip(callbacks, state["callbacks"], strict=True):
            callback.restore(remembered)
        _set_generators(algorithm, state["generators"])
    except (AttributeError, IndexError, KeyError, OverflowError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(f"the state does not fit this training ({type(error).__name__}: {error})") from None


def worlds_state(env: VecEnv) -> Any:
    """The state of all worlds: one tree for a batch, else a list."""
    return env.state() if isinstance(env, BatchVecEnv) else env.env_method("state")


def restore_worlds(env: VecEnv, state: Any) -> None:
    """Put the state of all worlds back."""
    if isinstance(env, BatchVecEnv):
        env.restore(state)
        return
    if len(state) != env.num_envs:
        raise ValueError(f"{len(state)} worlds for {env.num_envs}")
    for i, one in enumerate(state):
        env.env_method("restore", one, indices=[i])


# ---- the algorithm: whatever it counts, without a list of names for each algorithm


def _is_plain(value: Any) -> bool:
    return isinstance(value, bool | int | float | np.ndarray | np.generic) or (
        isinstance(value, deque) and all(isinstance(part, bool | int | float | np.generic | dict) for part in value)
    )


def _plain_attributes(what: Any) -> dict[str, Any]:
    return {name: value for name, value in vars(what).items() if _is_plain(value) and name not in _OF_THE_PROCESS}


def _set_plain_attributes(what: Any, values: Mapping[str, Any]) -> None:
    mine = _plain_attributes(what)
    for name, value in values.items():
        present = getattr(what, name, None)
        if isinstance(value, list) and (present is None or isinstance(present, deque)):  # the latest episodes
            setattr(what, name, deque(value, maxlen=what._stats_window_size))
        elif name in mine or (present is None and isinstance(value, np.ndarray)):  # such as the last observation
            setattr(what, name, _as(present, value, name))
        else:
            raise KeyError(name)


def _as(present: Any, value: Any, name: str) -> Any:
    """The value, if it may stand where `present` does."""
    if isinstance(present, np.ndarray):
        if not isinstance(value, np.ndarray) or (value.shape, value.dtype) != (present.shape, present.dtype):
            raise ValueError(f"{name} has another shape or type")
    elif present is not None and not isinstance(value, int | float):
        raise TypeError(f"{name} is no number")
    return value


# ---- the replay buffer: only as much of it as is filled


def _filled(buffer: BaseBuffer) -> dict[str, Any]:
    rows = buffer.size()
    attributes = _plain_attributes(buffer)
    return {
        name: value[:rows] if isinstance(value, np.ndarray) and len(value) == buffer.buffer_size else value
        for name, value in attributes.items()
    }


def _refill(buffer: BaseBuffer, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        present = getattr(buffer, name)
        if not isinstance(present, np.ndarray):
            setattr(buffer, name, _as(present, value, name))
        elif value.dtype != present.dtype or value.shape[1:] != present.shape[1:] or len(value) > len(present):
            raise ValueError(f"{name} of the replay buffer has another shape or type")
        else:
            present[: len(value)] = value


# ---- random numbers


def _generators(algorithm: BaseAlgorithm) -> dict[str, Any]:
    own = getattr(algorithm, "_rng", None)
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(legacy=False),  # noqa: NPY002 (Stable-Baselines3 draws from it)
        "torch": th.get_rng_state(),
        "actions": algorithm.action_space.np_random.bit_generator.state,
        "own": own.bit_generator.state if isinstance(own, np.random.Generator) else None,
    }


def _set_generators(algorithm: BaseAlgorithm, states: Mapping[str, Any]) -> None:
    kind, numbers, gauss = states["python"]
    random.setstate((kind, tuple(numbers), gauss))
    np.random.set_state(states["numpy"])  # noqa: NPY002
    th.set_rng_state(th.from_numpy(states["torch"]))
    algorithm.action_space.np_random.bit_generator.state = states["actions"]
    if states["own"] is not None:
        algorithm._rng.bit_generator.state = states["own"]  # type: ignore[attr-defined]
