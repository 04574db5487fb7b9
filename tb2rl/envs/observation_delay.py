"""Observations that arrive a few control steps late."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np

from tb2rl.envs.encodings import Observations, put_rows, rows


class ObservationDelay:
    """Delays observations by the latency of each environment.

    Args:
        max_latency: The largest latency [control steps]; with 0 observations pass unchanged.
    """

    def __init__(self, max_latency: int) -> None:
        self._max_latency = max_latency
        self._past: list[Observations] = []  # the last `max_latency` observations, the newest first

    def reset(self, first: Observations) -> None:
        """Start episodes in every environment; the first observations stand for those before."""
        self._past = [deepcopy(first) for _ in range(self._max_latency)]

    def reset_at(self, indices: np.ndarray, first: Observations) -> None:
        """Start episodes in the environments `indices` (n,); `first` has n rows."""
        for past in self._past:
            put_rows(past, indices, first)

    def __call__(self, latest: Observations, latency: np.ndarray) -> Observations:
        """The observations that arrive now.

        Args:
            latest: An array (num_envs, ...), or a mapping of such arrays.
            latency: Of each environment [control steps], shape (num_envs,).
        """
        if not self._max_latency:
            return latest
        arriving = deepcopy(latest)
        for steps, past in enumerate(self._past, start=1):
            indices = np.flatnonzero(latency == steps)
            put_rows(arriving, indices, rows(past, indices))
        self._past = [latest, *self._past[:-1]]
        return arriving

    def state(self) -> list[Observations]:
        """The observations on their way, copied."""
        return deepcopy(self._past)

    def restore(self, state: Sequence[Observations]) -> None:
        """Continue from a `state`."""
        self._past = [deepcopy(past) for past in state]
