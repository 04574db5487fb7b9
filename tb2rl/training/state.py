"""Capture and restore the state of a training, so that a resumed one continues bit by bit.

A state is captured where a rollout starts: there an on-policy buffer is empty, and all collected data is learned.
Stable-Baselines3 has no public access to the state of a learner, so this module uses its private attributes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.encodings import rows
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.parameters import parameters_of
from tb2rl.training.random_state import RestoreRandomState, exploration_matrices, generators_state, restore_generators
from tb2rl.training.saved_values import is_saved, restore_into

_NOT_SAVED = {  # of the process, not of the training; the last two are saved elsewhere, and set before they are read
    "verbose", "start_time", "_total_timesteps", "_num_timesteps_at_start", "tensorboard_log", "n_envs",
    "num_timesteps", "_last_original_obs",
}  # fmt: skip


class StatefulCallback(BaseCallback):
    """A callback whose attributes in `saved` belong to a checkpoint: numbers, and tuples or deques of numbers."""

    saved: ClassVar[tuple[str, ...]]

    def state(self) -> dict[str, Any]:
        """The saved attributes."""
        return {name.lstrip("_"): getattr(self, name) for name in self.saved}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue with saved attributes."""
        values = restore_into(self.state(), state, type(self).__name__)
        for name in self.saved:
            setattr(self, name, values[name.lstrip("_")])

    def _on_step(self) -> bool:
        return True


def capture(algorithm: BaseAlgorithm, callbacks: Sequence[StatefulCallback], in_rollout: bool) -> dict[str, Any]:
    """The state of a training as a tree for `write_checkpoint`, without the policy's parameters.

    Args:
        algorithm: The learner.
        callbacks: Callbacks with a state, always in the same order.
        in_rollout: Whether a rollout has just started, so that its exploration noise may be drawn already.
    """
    assert algorithm.env is not None
    parameters = parameters_of(algorithm)
    buffer = getattr(algorithm, "replay_buffer", None)
    return {
        "others": parameters["others"],
        "tensors": parameters["tensors"],
        "algorithm": _attributes(algorithm),
        "replay_buffer": None if buffer is None else _first_rows(_attributes(buffer), buffer, buffer.size()),
        "generators": generators_state(algorithm),
        "noise": exploration_matrices(algorithm) if in_rollout else None,
        "environments": _environments_state(algorithm.env),
        "callbacks": [callback.state() for callback in callbacks],
    }


def restore(
    state: Mapping[str, Any], algorithm: BaseAlgorithm, callbacks: Sequence[StatefulCallback]
) -> RestoreRandomState:
    """Restore a captured state into a training that has not begun; `load_parameters` restores the parameters.

    Returns:
        A callback that the training has to call before all others.

    Raises:
        InputError: If names, shapes or types of the state do not fit this training.
    """
    assert algorithm.env is not None
    try:
        _set_up(algorithm)
        for name, value in _restored(algorithm, state["algorithm"], _attributes(algorithm)).items():
            setattr(algorithm, name, value)
        if state["replay_buffer"] is not None:
            _refill(algorithm.replay_buffer, state["replay_buffer"])  # type: ignore[attr-defined]
        _restore_environments(algorithm.env, state["environments"])
        last = algorithm._last_obs
        if (normalized := algorithm.get_vec_normalize_env()) is not None:
            last = algorithm._last_original_obs = normalized.get_original_obs()
            algorithm._last_obs = normalized.normalize_obs(last)
        for i in range(algorithm.env.num_envs):
            if not algorithm.observation_space.contains(rows(last, i)):
                raise ValueError("the last observation lies outside the observation space")
        for callback, saved in zip(callbacks, state["callbacks"], strict=True):
            callback.restore(saved)
        restore_generators(algorithm, state["generators"])
        return RestoreRandomState(algorithm, state["generators"], state["noise"])
    except LIBRARY_ERRORS as error:
        raise InputError(one_line(f"the state does not fit this training ({type(error).__name__}: {error})")) from None


# ---- the algorithm


def _set_up(algorithm: BaseAlgorithm) -> None:
    """Set up what `learn` would, had nothing been learned yet."""
    assert algorithm.env is not None
    normalized = algorithm.get_vec_normalize_env()
    if normalized is not None:
        normalized.training = False  # its statistics are restored already, and this reset must not count
    algorithm._last_obs = algorithm.env.reset()  # type: ignore[assignment]
    if normalized is not None:
        normalized.training = True
    algorithm._last_episode_starts = np.ones(algorithm.env.num_envs, dtype=bool)
    algorithm.ep_info_buffer = deque(maxlen=algorithm._stats_window_size)
    algorithm.ep_success_buffer = deque(maxlen=algorithm._stats_window_size)


def _attributes(owner: Any) -> dict[str, Any]:
    """The attributes of an algorithm or a buffer that a checkpoint holds: all values except trained parameters.

    They are found by `vars`, because the algorithm may be any class of any package.
    """
    return {
        name: value
        for name, value in vars(owner).items()
        if is_saved(value) and name not in _NOT_SAVED and not getattr(value, "requires_grad", False)
    }


def _restored(owner: Any, saved: Mapping[str, Any], present: Mapping[str, Any]) -> dict[str, Any]:
    """Saved attributes in the form of the present ones, see `restore_into`.

    Raises:
        ValueError: If they do not fit, or a number contradicts the config.
    """
    if saved.keys() != present.keys():
        raise ValueError(f"other attributes: {', '.join(sorted(saved.keys() ^ present.keys()))}")
    classes: tuple[Any, ...] = type(owner).__mro__
    arguments = {name for each in classes for name in getattr(each.__init__, "__annotations__", ())}
    for name in arguments & present.keys():
        if isinstance(present[name], int | float) and saved[name] != present[name]:
            raise ValueError(f"{name} is {saved[name]!r}, and the config says {present[name]!r}")
    return {name: restore_into(value, saved[name], name) for name, value in present.items()}


# ---- the replay buffer: only its filled rows


def _first_rows(value: Any, buffer: BaseBuffer, count: int) -> Any:
    """Views of the first rows of all arrays in a tree that have a row for each place of the buffer."""
    if isinstance(value, Mapping):
        return {name: _first_rows(part, buffer, count) for name, part in value.items()}
    is_table = isinstance(value, np.ndarray) and value.ndim > 0 and len(value) == buffer.buffer_size
    return value[:count] if is_table else value


def _refill(buffer: BaseBuffer, saved: Mapping[str, Any]) -> None:
    present = _first_rows(_attributes(buffer), buffer, buffer.buffer_size if saved["full"] else saved["pos"])
    for name, value in _restored(buffer, saved, present).items():
        if not isinstance(value, np.ndarray | Mapping):  # arrays are written in place
            setattr(buffer, name, value)


# ---- the environments


def _environments_state(env: VecEnv) -> Any:
    """The state of all environments; with `VecNormalize`, a tree with its own state too, except its statistics."""
    batch: Any = env.unwrapped  # a `BatchVecEnv`
    normalized = unwrap_vec_normalize(env)
    if normalized is None:
        return batch.state()
    observations = normalized.get_original_obs()
    return {"inner": batch.state(), "returns": normalized.returns.copy(), "observations": observations}


def _restore_environments(env: VecEnv, saved: Any) -> None:
    state = restore_into(_environments_state(env), saved, "environments")
    normalized = unwrap_vec_normalize(env)
    if normalized is not None:
        normalized.returns, normalized.old_obs, state = state["returns"], state["observations"], state["inner"]
        if not np.isfinite(normalized.returns).all():
            raise ValueError("environments.returns are not finite")
    batch: Any = env.unwrapped
    batch.restore(state)
