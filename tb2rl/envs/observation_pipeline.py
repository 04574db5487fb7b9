"""What a learner observes as time goes by: the last observation, or the last few stacked, so that it sees changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import Encoding, Observations, SensorBox, numbers_of, put_rows, rows
from tb2rl.envs.episode_state import EpisodeState
from tb2rl.envs.observation_delay import Delay
from tb2rl.simulation import RobotState


class ObservationPipeline:
    """Turns the readings of some robots into what they observe: each as it is, or the last few as one.

    Numbers and classes stand one after the other, the oldest first; of images, the channels do. Where an episode
    begins, its first observation stands for those before it, as in Gymnasium's `FrameStackObservation`. (That wrapper
    has no version for a batch. Stable-Baselines3's `VecFrameStack` fills with zeros, which to a laser are walls, and
    knows no classes.)

    Args:
        encoding: From one reading to one observation.
        space: Of one robot's stacked observation, see `stacked_space`.
        frame_stack: How many observations are stacked.
        latency: The most control steps until a robot observes a reading.
        episode_states: What the robots remember.
        prompt: Which numbers are observed at once, however late readings are, bool, shape (numbers,); None: none.
    """

    def __init__(
        self,
        encoding: Encoding,
        space: spaces.Space,
        frame_stack: int,
        latency: int = 0,
        episode_states: Sequence[EpisodeState] = (),
        prompt: np.ndarray | None = None,
    ) -> None:
        self._encode, self._space, self._frame_stack = encoding, space, frame_stack
        self._delay, self._memories = Delay(latency), episode_states
        self._prompt = prompt if latency and prompt is not None and prompt.any() else None
        self._stack: Observations = None  # the latest; with one frame it is not kept

    def begin(self, robot_state: RobotState) -> Observations:
        """What the robots observe where the episodes of all of them begin."""
        for memory in self._memories:
            memory.begin(robot_state)
        latest = self._encode(self._remembering(robot_state, self._memories))
        self._delay.begin(latest)
        first = self._repeated(latest)
        if self._frame_stack > 1:
            self._stack = deepcopy(first)
        return first

    def go_on(self, robot_state: RobotState) -> Observations:
        """What the robots observe a step later."""
        for memory in self._memories:
            memory.go_on(robot_state)
        latest = self._encode(self._remembering(robot_state, self._memories))
        prompt = None if self._prompt is None else numbers_of(latest)[:, self._prompt]
        latest = self._delay.push(latest, robot_state.initial_state.observation_latency)
        if prompt is not None:
            numbers_of(latest)[:, self._prompt] = prompt
        if self._frame_stack == 1:
            return latest
        self._stack = _each(lambda new, old: np.concatenate([old[:, new.shape[1] :], new], axis=1), latest, self._stack)
        return deepcopy(self._stack)  # whoever gets it may write into it

    def begin_some(self, indices: np.ndarray, robot_state: RobotState, observations: Observations) -> None:
        """Put the first observations of new episodes into the observations of all robots, in place.

        Args:
            indices: Indices of those whose episodes begin, shape (n,).
            robot_state: Of these alone, n rows.
            observations: From `go_on`.
        """
        for memory in self._memories:
            memory.begin_some(indices, robot_state)
        latest = self._encode(self._remembering(robot_state, [memory.of(indices) for memory in self._memories]))
        self._delay.begin_some(indices, latest)
        first = self._repeated(latest)
        put_rows(observations, indices, first)
        if self._frame_stack > 1:
            put_rows(self._stack, indices, first)

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
        if self._frame_stack > 1:
            _check(stack, self._space)
            self._stack = deepcopy(stack)
        for observations in delayed:
            _check(observations, self._encode.space)
        self._delay.restore(delayed)
        for memory in self._memories:
            memory.restore(state[memory.field])

    @staticmethod
    def _remembering(robot_state: RobotState, episode_states: Sequence[EpisodeState]) -> RobotState:
        fields: dict[str, Any] = {memory.field: memory for memory in episode_states}
        return replace(robot_state, **fields) if fields else robot_state

    def _repeated(self, observations: Observations) -> Observations:
        if self._frame_stack == 1:
            return observations
        return _each(lambda new: np.concatenate([new] * self._frame_stack, axis=1), observations)


def _check(observations: Observations, space: spaces.Space) -> None:
    num_envs = len(next(iter(observations.values())) if isinstance(observations, dict) else observations)
    if not all(space.contains(rows(observations, robot)) for robot in range(num_envs)):
        raise ValueError("the stacked observations lie outside the observation space")


def stacked_space(space: spaces.Space, frame_stack: int) -> spaces.Space:
    """The space of so many stacked observations.

    Raises:
        InputError: If stacked images have more channels than rows or columns: Stable-Baselines3 would mistake them.
    """
    if frame_stack == 1:
        return space
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: stacked_space(part, frame_stack) for name, part in space.items()})
    if isinstance(space, spaces.MultiDiscrete):
        return spaces.MultiDiscrete(np.tile(space.nvec, frame_stack))
    if isinstance(space, SensorBox):
        return space.repeated(frame_stack)
    channels, *sides = space.shape or ()
    if frame_stack * channels > min(sides):
        raise InputError(
            f"task.frame_stack={frame_stack} makes images of {frame_stack * channels} channels, more than their "
            f"{min(sides)} rows or columns; take fewer"
        )
    return spaces.Box(0, 255, (frame_stack * channels, *sides), np.uint8)


def _each(function: Callable[..., np.ndarray], observations: Observations, *others: Any) -> Observations:
    """A function of arrays, applied to each part of observations."""
    if isinstance(observations, dict):
        return {name: function(part, *(other[name] for other in others)) for name, part in observations.items()}
    return function(observations, *others)
