"""What a learner observes as time goes by: the last observation, or the last few stacked, so that it sees changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import Encoding, Numbers, Observations, numbers_of, put_rows, rows
from tb2rl.envs.latency import Delay
from tb2rl.envs.memory import Memory
from tb2rl.simulation import Reading


class Observer:
    """Turns the readings of some robots into what they observe: each as it is, or the last few as one.

    Numbers and classes stand one after the other, the oldest first; of images, the channels do. Where an episode
    begins, its first observation stands for those before it, as in Gymnasium's `FrameStackObservation`. (That wrapper
    has no version for a batch. Stable-Baselines3's `VecFrameStack` fills with zeros, which to a laser are walls, and
    knows no classes.)

    Args:
        encoding: From one reading to one observation.
        space: Of one robot's stacked observation, see `stacked_space`.
        frames: How many observations are stacked.
        latency: The most control steps until a robot observes a reading.
        memories: What the robots remember.
        prompt: Which numbers are observed at once, however late readings are, bool, shape (numbers,); None: none.
    """

    def __init__(
        self,
        encoding: Encoding,
        space: spaces.Space,
        frames: int,
        latency: int = 0,
        memories: Sequence[Memory] = (),
        prompt: np.ndarray | None = None,
    ) -> None:
        self._encode, self._space, self._frames = encoding, space, frames
        self._delay, self._memories = Delay(latency), memories
        self._prompt = prompt if latency and prompt is not None and prompt.any() else None
        self._stack: Observations = None  # the latest; with one frame it is not kept

    def begin(self, reading: Reading) -> Observations:
        """What the robots observe where the episodes of all of them begin."""
        for memory in self._memories:
            memory.begin(reading)
        latest = self._encode(self._remembering(reading, self._memories))
        self._delay.begin(latest)
        first = self._repeated(latest)
        if self._frames > 1:
            self._stack = deepcopy(first)
        return first

    def go_on(self, reading: Reading) -> Observations:
        """What the robots observe a step later."""
        for memory in self._memories:
            memory.go_on(reading)
        latest = self._encode(self._remembering(reading, self._memories))
        prompt = None if self._prompt is None else numbers_of(latest)[:, self._prompt]
        latest = self._delay.pass_on(latest, reading.start.reading_latency)
        if prompt is not None:
            numbers_of(latest)[:, self._prompt] = prompt
        if self._frames == 1:
            return latest
        self._stack = _each(lambda new, old: np.concatenate([old[:, new.shape[1] :], new], axis=1), latest, self._stack)
        return deepcopy(self._stack)  # whoever gets it may write into it

    def begin_some(self, robots: np.ndarray, reading: Reading, observations: Observations) -> None:
        """Put the first observations of new episodes into the observations of all robots, in place.

        Args:
            robots: Indices of those whose episodes begin, shape (n,).
            reading: Of these alone, n rows.
            observations: From `go_on`.
        """
        for memory in self._memories:
            memory.begin_some(robots, reading)
        latest = self._encode(self._remembering(reading, [memory.of(robots) for memory in self._memories]))
        self._delay.begin_some(robots, latest)
        first = self._repeated(latest)
        put_rows(observations, robots, first)
        if self._frames > 1:
            put_rows(self._stack, robots, first)

    def state(self) -> dict[str, Any]:
        """The frames so far, None with one frame, and what is still on its way; in arrays of their own."""
        remembered = {memory.field: memory.state() for memory in self._memories}
        return {"stack": deepcopy(self._stack), "delayed": self._delay.state(), **remembered}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`.

        Raises:
            ValueError: If these are no observations.
        """
        stack, delayed = state["stack"], state["delayed"]
        if self._frames > 1:
            _check(stack, self._space)
            self._stack = deepcopy(stack)
        for observations in delayed:
            _check(observations, self._encode.space)
        self._delay.restore(delayed)
        for memory in self._memories:
            memory.restore(state[memory.field])

    @staticmethod
    def _remembering(reading: Reading, memories: Sequence[Memory]) -> Reading:
        fields: dict[str, Any] = {memory.field: memory for memory in memories}
        return replace(reading, **fields) if fields else reading

    def _repeated(self, observations: Observations) -> Observations:
        if self._frames == 1:
            return observations
        return _each(lambda new: np.concatenate([new] * self._frames, axis=1), observations)


def _check(observations: Observations, space: spaces.Space) -> None:
    robots = len(next(iter(observations.values())) if isinstance(observations, dict) else observations)
    if not all(space.contains(rows(observations, robot)) for robot in range(robots)):
        raise ValueError("the stacked observations lie outside the observation space")


def stacked_space(space: spaces.Space, frames: int) -> spaces.Space:
    """The space of so many stacked observations.

    Raises:
        InputError: If stacked images have more channels than rows or columns: Stable-Baselines3 would mistake them.
    """
    if frames == 1:
        return space
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: stacked_space(part, frames) for name, part in space.items()})
    if isinstance(space, spaces.MultiDiscrete):
        return spaces.MultiDiscrete(np.tile(space.nvec, frames))
    if isinstance(space, Numbers):
        return space.repeated(frames)
    channels, *sides = space.shape or ()
    if frames * channels > min(sides):
        raise InputError(
            f"task.frames={frames} makes images of {frames * channels} channels, more than their {min(sides)} "
            "rows or columns; take fewer"
        )
    return spaces.Box(0, 255, (frames * channels, *sides), np.uint8)


def _each(function: Callable[..., np.ndarray], observations: Observations, *others: Any) -> Observations:
    """A function of arrays, applied to each part of observations."""
    if isinstance(observations, dict):
        return {name: function(part, *(other[name] for other in others)) for name, part in observations.items()}
    return function(observations, *others)
