"""Many robots at one task, thousands in the twin; `vec_env` and `vector_env` are its two faces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tb2rl.envs.encodings import Observations, rows
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, RobotState, simulate_many
from tb2rl.simulation.random_streams import StreamDraws
from tb2rl.tasks import Outcome


class FinishedEpisodes(NamedTuple):
    """How the episodes of some robots ended, a row for each."""

    indices: np.ndarray  # their indices, shape (n,)
    observations: Observations  # (n, ...)
    infos: dict[str, np.ndarray]  # by the keys of `TurtleBot2Env`, each (n, ...)
    returns: np.ndarray  # shape (n,)
    lengths: np.ndarray  # [control steps], shape (n,)


class Step(NamedTuple):
    """What a step of all robots came to."""

    observations: Observations
    reward: np.ndarray  # shape (num_envs,), float64
    terminated: np.ndarray  # shape (num_envs,), bool
    truncated: np.ndarray  # shape (num_envs,), bool; of those that did not terminate
    finished: FinishedEpisodes | None  # None where no episode ended


class ControlLoop:
    """N robots, advanced together: no object for each, and no Python for each but where an episode ends.

    Each robot draws its start poses and its laser's noise from streams of its own, so what it meets depends on the seed
    and on itself, not on how many others there are nor on threads.

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        num_envs: How many.
        simulation: "kinematic" or "bullet", whose worlds are shared out among processes.

    Attributes:
        robot_state: The latest.
        distances: Driven since each robot's start [m], shape (num_envs,).
    """

    robot_state: RobotState

    def __init__(self, scene: Scene, num_envs: int, simulation: str = "kinematic") -> None:
        scene.check(simulation)
        self.scene, self.task, self.num_envs = scene, scene.task, num_envs
        self._actions, self._command_delay = scene.actions, scene.command_delay()
        self._observation_pipeline = scene.observation_pipeline(self._command_delay)
        self.simulation = simulate_many(simulation, scene.spec, num_envs)
        self.seed(None)

    def seed(self, seed: Any) -> None:
        """Say where the next reset's random numbers come from: anything that `numpy.random.default_rng` takes."""
        self._rng = np.random.default_rng(seed)

    def reset(self) -> Observations:
        """Begin an episode of every robot."""
        num_envs = self.num_envs
        starts, noise = self._rng.spawn(2)
        self._keys = starts.integers(2**64, size=num_envs, dtype=np.uint64)
        self._draws = np.zeros(num_envs, dtype=np.uint64)
        self._lengths = np.zeros(num_envs, dtype=np.int64)
        self._returns, self.distances = np.zeros(num_envs), np.zeros(num_envs)
        self.robot_state = self.simulation.reset(self._starts(np.arange(num_envs)), noise)
        return self._observation_pipeline.begin(self.robot_state)

    def step(self, actions: np.ndarray) -> Step:
        """`advance`, after which a robot whose episode ended is at the start of its next one already."""
        step = self.advance(actions)
        if step.finished is not None:
            self.reset_at(step.finished.indices, step.observations)
        return step

    def advance(self, actions: np.ndarray, over: np.ndarray | None = None) -> Step:
        """Hold an action of each robot for a control period.

        Args:
            actions: Shape (num_envs, ...).
            over: Robots whose episodes ended before and whose step does not count, bool, shape (num_envs,); None: none.
        """
        before = self.robot_state
        commands = self._command_delay.push(self._actions.commands(actions), before.initial_state.command_latency)
        after = self.simulation.step(commands, self.task.control_period)
        outcome = self.task.outcome(before, actions, after)
        reward, terminated = outcome.reward, outcome.terminated
        if over is not None:
            reward, terminated = np.where(over, 0.0, reward), terminated & ~over
        self._lengths += 1
        self._returns += reward
        self.distances += self.simulation.moved
        truncated = (self._lengths >= self.task.episode_steps) & ~terminated
        if over is not None:
            truncated &= ~over
        observations, finished = self._observation_pipeline.go_on(after), None
        ended = (terminated | truncated).nonzero()[0]
        if ended.size:
            infos = infos_of(after, ended, self.distances[ended], outcome)
            finished = FinishedEpisodes(
                ended, rows(observations, ended), infos, self._returns[ended], self._lengths[ended]
            )
        self.robot_state = after
        return Step(observations, reward, terminated, truncated, finished)

    def reset_at(self, indices: np.ndarray, observations: Observations) -> None:
        """Begin new episodes of some robots.

        Args:
            indices: Their indices in rising order, shape (n,).
            observations: The latest of all robots; the rows of these are overwritten, and so are those of the reading.
        """
        self._lengths[indices], self._returns[indices], self.distances[indices] = 0, 0.0, 0.0
        path_length = vars(self.robot_state).get("path_length")
        self.robot_state, first = self.simulation.restart(indices, self._starts(indices), self.robot_state)
        if path_length is not None:  # it was asked for, and takes long: of the others it is still the same
            vars(self.robot_state)["path_length"] = path_length = path_length.copy()
            path_length[indices] = first.path_length
        self._observation_pipeline.begin_some(indices, first, observations)

    def state(self) -> dict[str, Any]:
        """All that the rest of the episodes and later ones depend on, in plain values and arrays."""
        return {
            "simulation": self.simulation.state(),
            "reading": self.robot_state.state(),
            "frame_stack": self._observation_pipeline.state(),
            "keys": self._keys.copy(),
            "draws": self._draws.copy(),
            "lengths": self._lengths.copy(),
            "returns": self._returns.copy(),
            "distances": self.distances.copy(),
            "generator": self._rng.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state` as if nothing had happened since.

        Raises:
            ValueError: If a step from it would not end, or leave the worlds.
        """
        self.simulation.restore(state["simulation"])
        self.robot_state = RobotState.from_state(state["reading"], self.simulation)
        self._observation_pipeline.restore(state["frame_stack"])
        self._keys, self._draws = state["keys"].copy(), state["draws"].copy()
        self._lengths, self._returns = state["lengths"].copy(), state["returns"].copy()
        self.distances = state["distances"].copy()
        self._rng.bit_generator.state = state["generator"]

    def close(self) -> None:
        """Free what the simulation holds."""
        self.simulation.close()

    def _starts(self, indices: np.ndarray) -> InitialState:
        """New starts of the robots with these indices, one row each."""
        draws = StreamDraws(self._keys[indices], self._draws[indices])
        initial_state = self.task.randomized_initial_state(self.scene.spec, draws)
        self._draws[indices] = draws.counts
        return initial_state


def infos_of(
    robot_state: RobotState, indices: np.ndarray, distances: np.ndarray, outcome: Outcome
) -> dict[str, np.ndarray]:
    """The infos of robots whose episodes end, by the keys of `TurtleBot2Env`, a row for each.

    Args:
        robot_state: Of all robots.
        indices: Indices of those that end, shape (n,).
        distances: How far each has driven [m], shape (n,).
        outcome: Of all robots.
    """
    names, failed, success = zip(*outcome.endings(indices), strict=True)
    return {
        "pose": robot_state.pose[indices],
        "distance": distances,
        "min_range": robot_state.nearest[indices],
        "bumped": robot_state.bumped[indices],
        "is_success": np.array(success),
        "ended": np.array(names, dtype=object),
        "failed": np.array(failed),
    }
