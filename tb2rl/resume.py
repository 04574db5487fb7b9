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
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.vec_env import VecEnv

from tb2rl.errors import InputError, one_line
from tb2rl.vec_env import BatchVecEnv

_DOES_NOT_FIT = (AttributeError, IndexError, KeyError, OverflowError, RuntimeError, TypeError, ValueError)
_LARGEST = 1e12  # of any number in a state
_OF_THE_PROCESS = {  # not of the training; the last one is set anew before it is read
    "verbose", "start_time", "_total_timesteps", "_num_timesteps_at_start", "tensorboard_log", "n_envs",
    "_last_original_obs",
}  # fmt: skip


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
    """Put a captured state back; the policy's and the optimisers' parameters are the caller's.

    Everything is held against what a training that begins now looks like: the same names, shapes and types.

    Raises:
        InputError: If it does not fit this training.
    """
    assert algorithm.env is not None
    try:
        _begin(algorithm)
        _set_attributes(algorithm, state["algorithm"], may_change=_counters(algorithm))
        for observation in algorithm._last_obs:  # type: ignore[union-attr]
            if not algorithm.observation_space.contains(observation):
                raise ValueError("the last observation is none")
        if state["replay_buffer"] is not None:
            _refill(algorithm.replay_buffer, state["replay_buffer"], algorithm)  # type: ignore[attr-defined]
        restore_worlds(algorithm.env, state["worlds"])
        for callback, remembered in zip(callbacks, state["callbacks"], strict=True):
            callback.restore(remembered)
        _set_generators(algorithm, state["generators"])
    except _DOES_NOT_FIT as error:
        raise InputError(one_line(f"the state does not fit this training ({type(error).__name__}: {error})")) from None


def worlds_state(env: VecEnv) -> Any:
    """The state of all worlds: one tree for a batch, else a list."""
    return env.state() if isinstance(env, BatchVecEnv) else env.env_method("state")


def restore_worlds(env: VecEnv, state: Any) -> None:
    """Put the state of all worlds back; they have been reset.

    Raises:
        ValueError: If it is not one of such worlds.
    """
    check_like(state, worlds_state(env), "worlds")
    if isinstance(env, BatchVecEnv):
        env.restore(state)
        return
    for i, one in enumerate(state):
        env.env_method("restore", one, indices=[i])


def check_like(value: Any, example: Any, where: str) -> None:
    """Raise a ValueError where a tree has other names, shapes or types than an example, or holds no real number."""
    if isinstance(example, np.ndarray):
        if not isinstance(value, np.ndarray) or (value.shape, value.dtype) != (example.shape, example.dtype):
            raise ValueError(f"{where} has another shape or type")
        endless = where.endswith("ranges") and not np.isnan(value).any()  # nothing hit
        if value.dtype.kind == "f" and not endless and not (np.abs(value) < _LARGEST).all():
            raise ValueError(f"{where} holds no real number")
    elif isinstance(example, Mapping):
        if not isinstance(value, Mapping) or value.keys() != example.keys():
            raise ValueError(f"{where} has other keys")
        for key in example:
            check_like(value[key], example[key], f"{where}.{key}")
    elif isinstance(example, list | tuple):
        if not isinstance(value, list) or len(value) != len(example):
            raise ValueError(f"{where} has another length")
        for i, (part, like) in enumerate(zip(value, example, strict=True)):
            check_like(part, like, f"{where}.{i}")
    elif isinstance(example, bool | str | None):
        if type(value) is not type(example):
            raise ValueError(f"{where} has another type")
    elif isinstance(example, int):
        if type(value) is not int or value < 0:
            raise ValueError(f"{where} is no count")
    elif type(value) not in (int, float) or not abs(value) < _LARGEST:
        raise ValueError(f"{where} is no real number")


# ---- the algorithm: whatever it counts, without a list of names for each algorithm


def _begin(algorithm: BaseAlgorithm) -> None:
    """What `learn` sets up where nothing was learned yet."""
    assert algorithm.env is not None
    algorithm._last_obs = algorithm.env.reset()  # type: ignore[assignment]
    algorithm._last_episode_starts = np.ones(algorithm.env.num_envs, dtype=bool)
    algorithm.ep_info_buffer = deque(maxlen=algorithm._stats_window_size)
    algorithm.ep_success_buffer = deque(maxlen=algorithm._stats_window_size)


def _is_plain(value: Any) -> bool:
    return isinstance(value, bool | int | float | np.ndarray | np.generic | deque)


def _plain_attributes(what: Any) -> dict[str, Any]:
    return {name: value for name, value in vars(what).items() if _is_plain(value) and name not in _OF_THE_PROCESS}


def _counters(algorithm: BaseAlgorithm) -> set[str]:
    """The attributes that learning changes: not those that the constructor was given."""
    kinds: tuple[Any, ...] = type(algorithm).__mro__
    given = {name for kind in kinds for name in getattr(kind.__init__, "__annotations__", ())}
    return set(_plain_attributes(algorithm)) - given


def _set_attributes(what: Any, values: Mapping[str, Any], may_change: set[str]) -> None:
    present = _plain_attributes(what)
    if values.keys() != present.keys():
        raise ValueError(f"other attributes: {', '.join(sorted(values.keys() ^ present.keys()))}")
    for name, value in values.items():
        mine = present[name]
        if isinstance(mine, deque):
            mine.extend(_episode(part) if name == "ep_info_buffer" else bool(part) for part in value)
        elif isinstance(mine, np.ndarray) or name in may_change:
            check_like(value, mine, name)
            setattr(what, name, value)
        elif value != mine:
            raise ValueError(f"{name} is {value!r}, and the config says {mine!r}")


def _episode(info: Mapping[str, Any]) -> dict[str, float]:
    return {"r": float(info["r"]), "l": int(info["l"]), "t": float(info["t"])}


# ---- the replay buffer: only as much of it as is filled


def _filled(buffer: BaseBuffer) -> dict[str, Any]:
    rows = buffer.size()
    return {
        name: value[:rows] if isinstance(value, np.ndarray) else value
        for name, value in _plain_attributes(buffer).items()
    }


def _refill(buffer: BaseBuffer, values: Mapping[str, Any], algorithm: BaseAlgorithm) -> None:
    position, full = values["pos"], values["full"]
    if type(position) is not int or type(full) is not bool or not 0 <= position < buffer.buffer_size:
        raise ValueError("the replay buffer's position is outside it")
    rows = buffer.buffer_size if full else position
    arrays = {name: value for name, value in _plain_attributes(buffer).items() if isinstance(value, np.ndarray)}
    for name, array in arrays.items():
        check_like(values[name], array[:rows], f"replay_buffer.{name}")
    actions = values["actions"]
    if (
        isinstance(algorithm.action_space, spaces.Discrete)
        and not ((actions >= 0) & (actions < algorithm.action_space.n)).all()
    ):
        raise ValueError("replay_buffer.actions holds what is no action")
    _set_attributes(buffer, {**values, **arrays}, may_change={"pos", "full"})
    for name, array in arrays.items():
        array[:rows] = values[name]


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
