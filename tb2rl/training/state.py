"""Everything that the rest of a training depends on, taken and put back: so that a resumed one goes on to the bit.

Taken where a rollout starts: there an on-policy buffer is empty, and what has been collected has been learned from.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.callbacks import BaseCallback

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.encodings import rows
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.parameters import parameters_of
from tb2rl.training import environments
from tb2rl.training.randomness import PutBack, generators_of, noise_of, set_generators
from tb2rl.training.trees import fill, is_value

_NOT_HERE = {  # of the process, not of the training; the last two: saved elsewhere, and set anew before it is read
    "verbose", "start_time", "_total_timesteps", "_num_timesteps_at_start", "tensorboard_log", "n_envs",
    "num_timesteps", "_last_original_obs",
}  # fmt: skip


class Stateful(Protocol):
    """A callback that remembers."""

    def state(self) -> Mapping[str, Any]:
        """What it remembers, in plain values."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Remember that instead."""


def capture(algorithm: BaseAlgorithm, callbacks: Sequence[Stateful], in_rollout: bool) -> dict[str, Any]:
    """The state of a training as a tree for `write_checkpoint`, without the policy's parameters.

    Args:
        algorithm: What learns.
        callbacks: Those that remember, always in the same order.
        in_rollout: Whether a rollout has just started, so that what is random in it may have been drawn already.
    """
    assert algorithm.env is not None
    parameters = parameters_of(algorithm)
    return {
        "others": parameters["others"],
        "tensors": parameters["tensors"],
        "algorithm": _values(algorithm),
        "replay_buffer": _filled(getattr(algorithm, "replay_buffer", None)),
        "generators": generators_of(algorithm),
        "noise": noise_of(algorithm) if in_rollout else None,
        "environments": environments.state_of(algorithm.env),
        "callbacks": [dict(callback.state()) for callback in callbacks],
    }


def restore(state: Mapping[str, Any], algorithm: BaseAlgorithm, callbacks: Sequence[Stateful]) -> BaseCallback:
    """Put a captured state back; the parameters are the caller's, see `load_parameters`.

    Everything is held against what a training that begins now looks like: the same names, shapes and types.

    Returns:
        A callback that the training has to call before all others.

    Raises:
        InputError: If the state does not fit this training.
    """
    assert algorithm.env is not None
    try:
        _begin(algorithm)
        for name, value in _checked(algorithm, state["algorithm"], _values(algorithm)).items():
            setattr(algorithm, name, value)
        algorithm.ep_info_buffer = _queue(algorithm.ep_info_buffer, _episode)
        algorithm.ep_success_buffer = _queue(algorithm.ep_success_buffer, bool)
        if state["replay_buffer"] is not None:
            _refill(algorithm.replay_buffer, state["replay_buffer"])  # type: ignore[attr-defined]
        environments.restore(algorithm.env, state["environments"])
        last = algorithm._last_obs
        if (around := algorithm.get_vec_normalize_env()) is not None:
            last = algorithm._last_original_obs = around.get_original_obs()
            algorithm._last_obs = around.normalize_obs(last)
        for i in range(algorithm.env.num_envs):
            if not algorithm.observation_space.contains(rows(last, i)):
                raise ValueError("the last observation lies outside the observation space")
        for callback, remembered in zip(callbacks, state["callbacks"], strict=True):
            callback.restore(remembered)
        set_generators(algorithm, state["generators"])
        return PutBack(algorithm, state["generators"], state["noise"])
    except LIBRARY_ERRORS as error:
        raise InputError(one_line(f"the state does not fit this training ({type(error).__name__}: {error})")) from None


def _begin(algorithm: BaseAlgorithm) -> None:
    """What `learn` sets up where nothing was learned yet."""
    assert algorithm.env is not None
    around = algorithm.get_vec_normalize_env()
    if around is not None:
        around.training = False  # its statistics are put back already, and this reset does not count
    algorithm._last_obs = algorithm.env.reset()  # type: ignore[assignment]
    if around is not None:
        around.training = True
    algorithm._last_episode_starts = np.ones(algorithm.env.num_envs, dtype=bool)
    algorithm.ep_info_buffer = deque(maxlen=algorithm._stats_window_size)
    algorithm.ep_success_buffer = deque(maxlen=algorithm._stats_window_size)


def _queue(queue: deque | None, kind: Callable[[Any], Any]) -> deque:
    assert queue is not None
    return deque(map(kind, queue), maxlen=queue.maxlen)


def _episode(info: Mapping[str, Any]) -> dict[str, float]:
    return {"r": float(info["r"]), "l": int(info["l"]), "t": float(info["t"])}


def _values(what: Any) -> dict[str, Any]:
    """The attributes of an algorithm or a buffer that can be saved: whatever it counts, without a list of names.

    What an optimiser changes is among the parameters.
    """
    return {
        name: value
        for name, value in vars(what).items()
        if is_value(value) and name not in _NOT_HERE and not getattr(value, "requires_grad", False)
    }


def _checked(what: Any, values: Mapping[str, Any], present: Mapping[str, Any]) -> dict[str, Any]:
    """Saved attributes in the form of the present ones, whose arrays are written into.

    Raises:
        ValueError: If they are others, or say something else than the config does.
    """
    if values.keys() != present.keys():
        raise ValueError(f"other attributes: {', '.join(sorted(values.keys() ^ present.keys()))}")
    kinds: tuple[Any, ...] = type(what).__mro__
    arguments = {name for kind in kinds for name in getattr(kind.__init__, "__annotations__", ())}
    checked = {name: fill(mine, values[name], name) for name, mine in present.items()}
    for name in arguments & checked.keys():
        if isinstance(present[name], bool | int | float) and checked[name] != present[name]:
            raise ValueError(f"{name} is {checked[name]!r}, and the config says {present[name]!r}")
    return checked


# ---- the replay buffer: only as much of it as is filled


def _first_rows(value: Any, buffer: BaseBuffer, count: int) -> Any:
    """The first rows of every array in a tree that has a row for each place of the buffer; they are views."""
    if isinstance(value, Mapping):
        return {name: _first_rows(part, buffer, count) for name, part in value.items()}
    is_table = isinstance(value, np.ndarray) and value.ndim > 0 and len(value) == buffer.buffer_size
    return value[:count] if is_table else value


def _filled(buffer: BaseBuffer | None) -> dict[str, Any] | None:
    return None if buffer is None else _first_rows(_values(buffer), buffer, buffer.size())


def _refill(buffer: BaseBuffer, values: Mapping[str, Any]) -> None:
    position, full = values["pos"], values["full"]
    if type(position) is not int or type(full) is not bool or not 0 <= position < buffer.buffer_size:
        raise ValueError("the replay buffer's position is outside it")
    present = _first_rows(_values(buffer), buffer, buffer.buffer_size if full else position)
    for name, value in _checked(buffer, values, present).items():
        if not isinstance(value, np.ndarray | Mapping):
            setattr(buffer, name, value)
