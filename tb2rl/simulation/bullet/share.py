"""The PyBullet worlds of one process; the robot states go into records of shared memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tb2rl.simulation.bullet.simulator import BulletSimulator
from tb2rl.simulation.initial_state import InitialState
from tb2rl.simulation.robot_state import RobotState
from tb2rl.simulation.spec import SimulationSpec


class Share:
    """The worlds of one process.

    Args:
        spec: The robot, its laser and the worlds.
        num_envs: Number of them.

    Attributes:
        names: Of the arrays of a `RobotState`.
        record_type: Robot state and initial state of an environment as one record.
    """

    def __init__(self, spec: SimulationSpec, num_envs: int) -> None:
        self._worlds = [BulletSimulator(spec) for _ in range(num_envs)]
        self._rng = [np.random.default_rng() for _ in range(num_envs)]
        initial_state = InitialState.default(spec, 1)
        self._first = [world.reset(initial_state, rng) for world, rng in zip(self._worlds, self._rng, strict=True)]
        columns = self._first[0].state()
        self.names = [name for name in columns if name != "initial_state"]
        self.record_type = np.dtype([(name, c.dtype, c.shape[1:]) for name, c in columns.items()], align=True)

    def write_to(self, records: np.ndarray) -> None:
        """Write to these records, shape (num_envs,), from now on."""
        self._records, self._measured = records, records[self.names]
        for i, robot_state in enumerate(self._first):
            self._write(i, robot_state)

    def reset(self, rng: list[np.random.Generator]) -> None:
        """Start an episode in every world from the initial states in the records."""
        self.reset_at(range(len(rng)), rng)

    def reset_at(self, indices: Sequence[int], rng: Sequence[np.random.Generator] | None = None) -> None:
        """Start new episodes in some worlds."""
        for number, i in enumerate(indices):
            if rng is not None:
                self._rng[i] = rng[number]
            initial_state = InitialState(self._records["initial_state"][i : i + 1].copy())
            self._write(i, self._worlds[i].reset(initial_state, self._rng[i]))

    def step(self, duration: float, skip: np.ndarray | None = None) -> None:
        """Drive by the commands in the records."""
        commands = self._records["command"].copy()
        for i, world in enumerate(self._worlds):
            if skip is None or not skip[i]:
                self._measured[i] = world.drive(commands[i : i + 1], duration)

    def state(self) -> list[dict[str, Any]]:
        """The state of each world."""
        return [world.state() for world in self._worlds]

    def restore(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Continue from the states of all worlds."""
        for i, (world, state) in enumerate(zip(self._worlds, states, strict=True)):
            self._write(i, world.restore(state))

    def render_cameras(self, indices: Iterable[int], width: int, height: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Colours and depth of the cameras in some worlds."""
        return [self._worlds[i].camera(width, height) for i in indices]

    def close(self) -> None:
        """Close the worlds."""
        for world in self._worlds:
            world.close()

    def _write(self, i: int, robot_state: RobotState) -> None:
        self._measured[i] = tuple(getattr(robot_state, name)[0] for name in self.names)
        self._records["initial_state"][i] = robot_state.initial_state.table[0]
