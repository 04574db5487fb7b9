"""The pipeline from robot states to observations: episode state, encoding, latency, frame stack."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.envs.command_history import CommandHistory
from tb2rl.envs.encodings import Encoding, Observations, SensorBox, numbers_of, put_rows, rows
from tb2rl.envs.episode_state import EpisodeState
from tb2rl.envs.observation_delay import ObservationDelay
from tb2rl.simulation import RobotState


class ObservationPipeline:
    """Turns robot states into observations, and stacks the last ones.

    Numbers and classes are stacked one after the other, the oldest first; of images, the channels. At the start of an
    episode the first observation stands for those before it, as in Gymnasium's `FrameStackObservation`, which has no
    version for a batch. (Stable-Baselines3's `VecFrameStack` fills with zeros, which mean walls to a laser.)

    Args:
        encoding: From a robot state to an observation.
        space: Of one environment's stacked observation, see `stacked_space`.
        frame_stack: Number of stacked observations.
        latency: The largest observation latency [control steps].
        episode_states: What sensors find in the robot state.
        prompt: Numbers that are observed without latency, bool, shape (numbers,); None: none.
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
        self._delay, self._episode_states = ObservationDelay(latency), episode_states
        self._prompt = prompt if latency and prompt is not None and prompt.any() else None
        self._stack: Observations = None  # the latest; with one frame it is not kept

    def reset(self, robot_state: RobotState) -> Observations:
        """The first observations of episodes in every environment."""
        for each in self._episode_states:
            each.reset(robot_state)
        latest = self._encode(_with_fields(robot_state, self._episode_states))
        self._delay.reset(latest)
        first = self._repeated(latest)
        if self._frame_stack > 1:
            self._stack = deepcopy(first)
        return first

    def remember(self, commands: np.ndarray) -> None:
        """Take in the commands of a control step, shape (num_envs, 2), before `step`."""
        for each in self._episode_states:
            if isinstance(each, CommandHistory):
                each.push(commands)

    def step(self, robot_state: RobotState) -> Observations:
        """The observations after a control step."""
        for each in self._episode_states:
            each.update(robot_state)
        latest = self._encode(_with_fields(robot_state, self._episode_states))
        prompt = None if self._prompt is None else numbers_of(latest)[:, self._prompt]
        latest = self._delay(latest, robot_state.initial_state.observation_latency)
        if prompt is not None:
            numbers_of(latest)[:, self._prompt] = prompt
        if self._frame_stack == 1:
            return latest
        self._stack = _each(lambda new, old: np.concatenate([old[:, new.shape[1] :], new], axis=1), latest, self._stack)
        return deepcopy(self._stack)  # because callers may write into it

    def reset_at(self, indices: np.ndarray, robot_state: RobotState, observations: Observations) -> None:
        """Put the first observations of new episodes into those of all environments, in place.

        Args:
            indices: Of these environments, shape (n,).
            robot_state: Of these, n rows.
            observations: From `step`.
        """
        for each in self._episode_states:
            each.reset_at(indices, robot_state)
        some = [each.rows(indices) for each in self._episode_states]
        latest = self._encode(_with_fields(robot_state, some))
        self._delay.reset_at(indices, latest)
        first = self._repeated(latest)
        put_rows(observations, indices, first)
        if self._frame_stack > 1:
            put_rows(self._stack, indices, first)

    def state(self) -> dict[str, Any]:
        """The stacked and the delayed observations, and the episode states; copied."""
        remembered = {each.field: each.state() for each in self._episode_states}
        return {"stack": deepcopy(self._stack), "delayed": self._delay.state(), **remembered}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state`.

        Raises:
            ValueError: If its observations are not of the observation space.
        """
        stack, delayed = state["stack"], state["delayed"]
        if self._frame_stack > 1:
            _check(stack, self._space)
            self._stack = deepcopy(stack)
        for observations in delayed:
            _check(observations, self._encode.space)
        self._delay.restore(delayed)
        for each in self._episode_states:
            each.restore(state[each.field])

    def _repeated(self, observations: Observations) -> Observations:
        if self._frame_stack == 1:
            return observations
        return _each(lambda new: np.concatenate([new] * self._frame_stack, axis=1), observations)


def _with_fields(robot_state: RobotState, episode_states: Sequence[EpisodeState]) -> RobotState:
    fields: dict[str, Any] = {each.field: each for each in episode_states}
    return replace(robot_state, **fields) if fields else robot_state


def _check(observations: Observations, space: spaces.Space) -> None:
    num_envs = len(next(iter(observations.values())) if isinstance(observations, dict) else observations)
    if not all(space.contains(rows(observations, i)) for i in range(num_envs)):
        raise ValueError("the stacked observations lie outside the observation space")


def stacked_space(space: spaces.Space, frame_stack: int) -> spaces.Space:
    """The space of stacked observations.

    Raises:
        InputError: If stacked images have more channels than rows or columns, because Stable-Baselines3 would mistake
            them for images with the channels last.
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
    """Apply a function of arrays to each part of observations."""
    if isinstance(observations, dict):
        return {name: function(part, *(other[name] for other in others)) for name, part in observations.items()}
    return function(observations, *others)
