"""What comes late: readings that a robot observes a few control steps later."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np

from tb2rl.envs.encodings import Observations, put_rows, rows


class Delay:
    """Hands on what comes in, to each robot as many control steps later as it is late.

    Args:
        most: The latest that any robot can be [control steps]; with 0 everything is handed on as it is.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._past: list[Observations] = []  # the last `most` that came in, the newest first

    def begin(self, first: Observations) -> None:
        """Where the episodes of all robots begin: `first`, with a row for each, stands for what was before."""
        self._past = [deepcopy(first) for _ in range(self._most)]

    def begin_some(self, indices: np.ndarray, first: Observations) -> None:
        """The same for the robots with indices `robots` (n,) alone, n rows."""
        for past in self._past:
            put_rows(past, indices, first)

    def push(self, latest: Observations, late: np.ndarray) -> Observations:
        """What arrives at the robots now.

        Args:
            latest: What comes in: an array (num_envs, ...), or a mapping of such arrays.
            late: By how many control steps each robot is late, shape (num_envs,).
        """
        if not self._most:
            return latest
        arriving = deepcopy(latest)
        for steps, past in enumerate(self._past, start=1):
            indices = np.flatnonzero(late == steps)
            put_rows(arriving, indices, rows(past, indices))
        self._past = [latest, *self._past[:-1]]
        return arriving

    def state(self) -> list[Observations]:
        """What is on its way, in arrays of its own."""
        return deepcopy(self._past)

    def restore(self, state: Sequence[Observations]) -> None:
        """Go on from a `state`."""
        self._past = [deepcopy(past) for past in state]
