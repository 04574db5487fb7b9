"""The pipeline from robot states to observations: episode state, encoding, latency, frame stack."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import Encoding, Observations, SensorBox, map_arrays, numbers_of, put_rows, take_rows
from tb2rl.envs.episode_state import EpisodeState
from tb2rl.sensors import Sensor
from tb2rl.simulation import RobotState


class History:
    """Commands or observations of all environments in the last control steps.

    Args:
        length: Number of control steps.

    Attributes:
        values: Values of all environments, the newest first.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self.values: list[Observations] = []

    def reset(self, initial: Observations) -> None:
        """Start episodes in every environment, with copies of the initial value as history."""
        self.values = [deepcopy(initial) for _ in range(self._length)]

    def reset_at(self, indices: np.ndarray, initial: Observations) -> None:
        """Start episodes in the environments `indices` (n,), with the rows of `initial` (n, ...) as history."""
        for value in self.values:
            put_rows(value, indices, initial)

    def push(self, latest: Observations) -> None:
        """Add the latest value, which must not change afterwards, and drop the oldest."""
        self.values = [latest, *self.values][: self._length]

    def delay(self, latest: Observations, latency: np.ndarray) -> Observations:
        """Push the latest value, and return each environment's value from `latency` steps ago.

        Args:
            latest: Shape (num_envs, ...).
            latency: Latency of each environment [control steps], shape (num_envs,), at most the length.
        """
        delayed = map_arrays(np.copy, latest)
        for steps, value in enumerate(self.values, start=1):
            indices = (latency == steps).nonzero()[0]
            if len(indices):
                put_rows(delayed, indices, take_rows(value, indices))
        self.push(latest)
        return delayed


class ObservationPipeline:
    """Turns robot states into observations, delays the observations, and stacks the last ones.

    Vectors of numbers or bins are concatenated, the oldest first, and so are the channels of images. At the start
    of an episode the first observation is repeated, as in Gymnasium's `FrameStackObservation`, which has no batched
    version. (Stable-Baselines3's `VecFrameStack` starts with zeros, which look like walls in laser ranges.)

    Args:
        encoding: Function from a robot state to an observation.
        sensors: The sensors whose readings the encoding concatenates, in this order.
        episode_states: What sensors read of the episode so far, such as the past commands or poses.
        frame_stack: Number of stacked observations.
        latency: Largest observation latency [control steps]; past commands in observations are not delayed.
    """

    def __init__(
        self,
        encoding: Encoding,
        sensors: Sequence[Sensor],
        episode_states: Sequence[EpisodeState],
        frame_stack: int,
        latency: int,
    ) -> None:
        self._encode, self._episode_states = encoding, episode_states
        self._frame_stack, self._latency = frame_stack, latency
        self._frames, self._held_back = History(frame_stack - 1), History(latency)
        numbers = [sensor for sensor in sensors if len(sensor.shape) == 1]
        reads_commands = [sensor.command_history_length > 0 for sensor in numbers]
        # Mask of the columns of a vector that hold past commands.
        self._is_command = np.repeat(reads_commands, [sensor.shape[0] for sensor in numbers])

    def reset(self, robot_state: RobotState) -> Observations:
        """Start episodes in every environment, and return the first observations."""
        for episode_state in self._episode_states:
            episode_state.reset(robot_state)
        initial = self._encode(_with_episode_states(robot_state, self._episode_states))
        self._held_back.reset(initial)
        self._frames.reset(initial)
        return _concatenate([initial] * self._frame_stack)

    def step(self, robot_state: RobotState, commands: np.ndarray) -> Observations:
        """The observations after a control step; `commands` (num_envs, 2) are those of the step, before latency."""
        for episode_state in self._episode_states:
            episode_state.update(robot_state, commands)
        latest = self._encode(_with_episode_states(robot_state, self._episode_states))
        if self._latency:
            commands_now = numbers_of(latest)[:, self._is_command] if self._is_command.any() else None
            latest = self._held_back.delay(latest, robot_state.initial_state.records["observation_latency"])
            if commands_now is not None:
                numbers_of(latest)[:, self._is_command] = commands_now
        stacked = _concatenate([*reversed(self._frames.values), latest])
        self._frames.push(latest)
        return stacked

    def reset_at(self, indices: np.ndarray, robot_state: RobotState, observations: Observations) -> None:
        """Start new episodes in some environments, and put their first observations into `observations`.

        Args:
            indices: Indices of these environments, shape (n,).
            robot_state: Their robot state, n rows.
            observations: The latest observations of all environments.
        """
        for episode_state in self._episode_states:
            episode_state.reset_at(indices, robot_state)
        selected = [episode_state.rows(indices) for episode_state in self._episode_states]
        initial = self._encode(_with_episode_states(robot_state, selected))
        self._held_back.reset_at(indices, initial)
        self._frames.reset_at(indices, initial)
        put_rows(observations, indices, _concatenate([initial] * self._frame_stack))

    def state(self) -> dict[str, Any]:
        """Copies of the earlier frames, the observations that latency holds back, and the episode states."""
        states = {episode_state.field: episode_state.state() for episode_state in self._episode_states}
        return {"frames": deepcopy(self._frames.values), "late": deepcopy(self._held_back.values), **states}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state`."""
        self._frames.values, self._held_back.values = deepcopy(state["frames"]), deepcopy(state["late"])
        for episode_state in self._episode_states:
            episode_state.restore(state[episode_state.field])


def _with_episode_states(robot_state: RobotState, episode_states: Sequence[EpisodeState]) -> RobotState:
    fields: dict[str, Any] = {episode_state.field: episode_state for episode_state in episode_states}
    return replace(robot_state, **fields) if fields else robot_state


def _concatenate(frames: Sequence[Observations]) -> Observations:
    if len(frames) == 1:
        return frames[0]
    return map_arrays(lambda *arrays: np.concatenate(arrays, axis=1), *frames)


def stacked_space(space: spaces.Space, frame_stack: int) -> spaces.Space:
    """The space of stacked observations.

    Raises:
        InputError: If stacked images have more channels than rows or columns. Stable-Baselines3 would take their last
            axis for the channels.
    """
    if frame_stack == 1:
        return space
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: stacked_space(subspace, frame_stack) for name, subspace in space.items()})
    if isinstance(space, spaces.MultiDiscrete):
        return spaces.MultiDiscrete(np.tile(space.nvec, frame_stack))
    if isinstance(space, SensorBox):
        return space.repeated(frame_stack)
    channels, *sides = space.shape or ()
    channels *= frame_stack
    if channels > min(sides):
        problem = f"makes images of {channels} channels, more than their {min(sides)} rows or columns"
        raise InputError(f"task.frame_stack={frame_stack} {problem}; stack fewer")
    return spaces.Box(0, 255, (channels, *sides), np.uint8)
