"""One control step, for any number of environments: action, command, filters, simulator, outcome, observation.

Gymnasium's environment, the vector environments, evaluations and films all advance by this loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from tb2rl.envs.encodings import Observations, rows
from tb2rl.envs.filters import CommandDelay
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, RobotState, Simulator, find_simulator
from tb2rl.simulation.simulator import Generators
from tb2rl.tasks import Outcome


class FinishedEpisodes(NamedTuple):
    """The episodes that ended in a step, one row for each."""

    indices: np.ndarray  # of their environments, ascending, shape (n,)
    observations: Observations  # (n, ...)
    infos: dict[str, np.ndarray]  # by the keys of `TurtleBot2Env`, each (n, ...)
    returns: np.ndarray  # shape (n,)
    lengths: np.ndarray  # [control steps], shape (n,)


class Transition(NamedTuple):
    """A step of all environments; observations and robot state are those before any reset."""

    observations: Observations
    reward: np.ndarray  # shape (num_envs,), float64
    terminated: np.ndarray  # shape (num_envs,), bool
    truncated: np.ndarray  # shape (num_envs,), bool; only where not terminated
    outcome: Outcome
    finished: FinishedEpisodes | None  # None where no episode ended


class ControlLoop:
    """Advances all environments of a simulator at the task of a scene.

    What an environment meets depends on its initial state, its random numbers and its actions, not on the others.

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        simulator: Of the scene's spec.

    Attributes:
        robot_state: The latest; None before the first `reset`.
        distances: Driven since the start of each episode [m], shape (num_envs,).
        lengths: Control steps since then, shape (num_envs,).
    """

    robot_state: RobotState

    def __init__(self, scene: Scene, simulator: Simulator) -> None:
        self.scene, self.task, self.simulator, self.num_envs = scene, scene.task, simulator, simulator.num_envs
        self._actions, self._filters = scene.actions, scene.make_filters()
        self._observations = scene.observation_pipeline()

    @classmethod
    def open(
        cls, scene: Scene, simulation: Any, num_envs: int = 1, window: bool = False, processes: int | None = None
    ) -> Self:
        """A loop with a simulator of its own.

        Args:
            scene: The task, the robot and the worlds; the simulator may adapt it.
            simulation: What `find_simulator` takes.
            num_envs: Number of environments.
            window: Whether to open the simulator's window.
            processes: Number of processes; None: what suits the simulator.

        Raises:
            InputError: If the simulator cannot run here, or cannot show what a sensor reads.
        """
        kind = find_simulator(simulation)
        scene = kind.prepare(scene)
        scene.check(kind)
        return cls(scene, kind.open(scene.spec, num_envs, window, processes))

    def reset(self, initial_state: InitialState, rng: Generators) -> Observations:
        """Start an episode in every environment.

        Args:
            initial_state: A row for each.
            rng: Source of the sensor noise, see `Simulator.reset`.
        """
        self.lengths = np.zeros(self.num_envs, dtype=np.int64)
        self._returns, self.distances = np.zeros(self.num_envs), np.zeros(self.num_envs)
        for each in self._filters:
            each.reset(self.num_envs)
        self.robot_state = self.simulator.reset(initial_state, rng)
        return self._observations.reset(self.robot_state)

    def step(self, actions: np.ndarray, skip: np.ndarray | None = None) -> Transition:
        """Hold an action in each environment for a control period.

        Args:
            actions: Shape (num_envs, ...).
            skip: Environments whose episode has ended before and whose step does not count, bool, shape (num_envs,).
        """
        before = self.robot_state
        commands = self._actions.commands(actions)
        for each in self._filters:
            if isinstance(each, CommandDelay):  # sensors of commands see them before their latency
                self._observations.remember(commands)
            commands = each(commands, before)
        after = self.simulator.step(commands, self.task.control_period, skip)
        outcome = self.task.outcome(before, actions, after)
        reward, terminated = outcome.reward, outcome.terminated
        if skip is not None:
            reward, terminated = np.where(skip, 0.0, reward), terminated & ~skip
        self.lengths += 1
        self._returns += reward
        self.distances += self.simulator.travelled
        truncated = (self.lengths >= self.task.episode_steps) & ~terminated
        if skip is not None:
            truncated &= ~skip
        self.robot_state, observations, finished = after, self._observations.step(after), None
        ended = (terminated | truncated).nonzero()[0]
        if ended.size:
            infos = self._final_infos(ended, outcome)
            counts = self._returns[ended], self.lengths[ended]
            finished = FinishedEpisodes(ended, rows(observations, ended), infos, *counts)
        return Transition(observations, reward, terminated, truncated, outcome, finished)

    def reset_at(
        self,
        indices: np.ndarray,
        initial_state: InitialState,
        observations: Observations,
        rng: Sequence[np.random.Generator] | None = None,
    ) -> None:
        """Start new episodes in some environments.

        Args:
            indices: Of these, ascending, shape (n,).
            initial_state: n rows.
            observations: The latest of all; the rows of these environments are overwritten, as are those of the state.
            rng: Sources of their sensor noise, n; None: the present ones go on.
        """
        self.lengths[indices], self._returns[indices], self.distances[indices] = 0, 0.0, 0.0
        for each in self._filters:
            each.reset_at(indices)
        before = self.robot_state
        self.robot_state, first = self.simulator.reset_at(indices, initial_state, before, rng)
        self.robot_state.keep_path_lengths(before, indices, first)
        self._observations.reset_at(indices, first, observations)

    def infos(self) -> dict[str, np.ndarray]:
        """Infos of all environments while their episodes go on, by the keys of `TurtleBot2Env`."""
        ongoing = np.zeros(self.num_envs, dtype=bool)
        return {
            "pose": self.robot_state.pose.copy(),
            "distance": self.distances.copy(),
            "min_range": self.robot_state.nearest,
            "bumped": self.robot_state.bumped.copy(),
            "is_success": ongoing,
            "ended": np.full(self.num_envs, "", dtype=object),
            "failed": ongoing,
        }

    def _final_infos(self, indices: np.ndarray, outcome: Outcome) -> dict[str, np.ndarray]:
        names, failed, success = zip(*outcome.endings(indices), strict=True)
        return {
            "pose": self.robot_state.pose[indices],
            "distance": self.distances[indices],
            "min_range": self.robot_state.nearest[indices],
            "bumped": self.robot_state.bumped[indices],
            "is_success": np.array(success),
            "ended": np.array(names, dtype=object),
            "failed": np.array(failed),
        }

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the episodes depends on, as plain values and arrays."""
        return {
            "simulator": self.simulator.state(),
            "robot_state": self.robot_state.state(),
            "observations": self._observations.state(),
            "filters": [each.state() for each in self._filters],
            "lengths": self.lengths.copy(),
            "returns": self._returns.copy(),
            "distances": self.distances.copy(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state`.

        Raises:
            ValueError: If a step from it would not end, or leave the worlds.
        """
        self.simulator.restore(state["simulator"])
        self.robot_state = RobotState.from_state(state["robot_state"], self.simulator)
        self._observations.restore(state["observations"])
        for each, kept in zip(self._filters, state["filters"], strict=True):
            each.restore(kept)
        self.lengths, self._returns = state["lengths"].copy(), state["returns"].copy()
        self.distances = state["distances"].copy()

    def close(self) -> None:
        """Release what the simulator holds."""
        self.simulator.close()
