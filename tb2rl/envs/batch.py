"""Many robots at one task, thousands in the twin; `vec_env` and `vector_env` are its two faces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tb2rl.envs.encodings import Observations, rows
from tb2rl.envs.scene import Scene
from tb2rl.simulation import Reading, Start, simulate_many
from tb2rl.simulation.streams import StreamDraws
from tb2rl.tasks import Outcome


class Finals(NamedTuple):
    """How the episodes of some robots ended, a row for each."""

    robots: np.ndarray  # their indices, shape (n,)
    observations: Observations  # (n, ...)
    infos: dict[str, np.ndarray]  # by the keys of `TurtleBot2Env`, each (n, ...)
    returns: np.ndarray  # shape (n,)
    lengths: np.ndarray  # [control steps], shape (n,)


class Step(NamedTuple):
    """What a step of all robots came to."""

    observations: Observations
    reward: np.ndarray  # shape (robots,), float64
    terminated: np.ndarray  # shape (robots,), bool
    truncated: np.ndarray  # shape (robots,), bool; of those that did not terminate
    finals: Finals | None  # None where no episode ended


class Batch:
    """N robots, advanced together: no object for each, and no Python for each but where an episode ends.

    Each robot draws its start poses and its laser's noise from streams of its own, so what it meets depends on the seed
    and on itself, not on how many others there are nor on threads.

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        robots: How many.
        simulation: "kinematic" or "bullet", whose worlds are shared out among processes.

    Attributes:
        reading: The latest.
        distances: Driven since each robot's start [m], shape (robots,).
    """

    reading: Reading

    def __init__(self, scene: Scene, robots: int, simulation: str = "kinematic") -> None:
        scene.check(simulation)
        self.scene, self.task, self.robots = scene, scene.task, robots
        self._actions, self._commander = scene.actions, scene.commander()
        self._observer = scene.observer(self._commander)
        self.simulation = simulate_many(simulation, scene.setup, robots)
        self.seed(None)

    def seed(self, seed: Any) -> None:
        """Say where the next reset's random numbers come from: anything that `numpy.random.default_rng` takes."""
        self._rng = np.random.default_rng(seed)

    def reset(self) -> Observations:
        """Begin an episode of every robot."""
        robots = self.robots
        starts, noise = self._rng.spawn(2)
        self._keys = starts.integers(2**64, size=robots, dtype=np.uint64)
        self._draws = np.zeros(robots, dtype=np.uint64)
        self._lengths = np.zeros(robots, dtype=np.int64)
        self._returns, self.distances = np.zeros(robots), np.zeros(robots)
        self.reading = self.simulation.reset(self._starts(np.arange(robots)), noise)
        return self._observer.begin(self.reading)

    def step(self, actions: np.ndarray) -> Step:
        """`advance`, after which a robot whose episode ended is at the start of its next one already."""
        step = self.advance(actions)
        if step.finals is not None:
            self.begin_again(step.finals.robots, step.observations)
        return step

    def advance(self, actions: np.ndarray, over: np.ndarray | None = None) -> Step:
        """Hold an action of each robot for a control period.

        Args:
            actions: Shape (robots, ...).
            over: Robots whose episodes ended before and whose step does not count, bool, shape (robots,); None: none.
        """
        before = self.reading
        commands = self._commander.pass_on(self._actions.commands(actions), before.start.command_latency)
        after = self.simulation.step(commands, self.task.control_period)
        outcome = self.task.judge(before, actions, after)
        reward, terminated = outcome.reward, outcome.terminated
        if over is not None:
            reward, terminated = np.where(over, 0.0, reward), terminated & ~over
        self._lengths += 1
        self._returns += reward
        self.distances += self.simulation.moved
        truncated = (self._lengths >= self.task.episode_steps) & ~terminated
        if over is not None:
            truncated &= ~over
        observations, finals = self._observer.go_on(after), None
        ended = (terminated | truncated).nonzero()[0]
        if ended.size:
            infos = infos_of(after, ended, self.distances[ended], outcome)
            finals = Finals(ended, rows(observations, ended), infos, self._returns[ended], self._lengths[ended])
        self.reading = after
        return Step(observations, reward, terminated, truncated, finals)

    def begin_again(self, robots: np.ndarray, observations: Observations) -> None:
        """Begin new episodes of some robots.

        Args:
            robots: Their indices in rising order, shape (n,).
            observations: The latest of all robots; the rows of these are overwritten, and so are those of the reading.
        """
        self._lengths[robots], self._returns[robots], self.distances[robots] = 0, 0.0, 0.0
        to_go = vars(self.reading).get("to_go")
        self.reading, first = self.simulation.restart(robots, self._starts(robots), self.reading)
        if to_go is not None:  # it was asked for, and takes long: of the others it is still the same
            vars(self.reading)["to_go"] = to_go = to_go.copy()
            to_go[robots] = first.to_go
        self._observer.begin_some(robots, first, observations)

    def state(self) -> dict[str, Any]:
        """All that the rest of the episodes and later ones depend on, in plain values and arrays."""
        return {
            "simulation": self.simulation.state(),
            "reading": self.reading.state(),
            "frames": self._observer.state(),
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
        self.reading = Reading.from_state(state["reading"], self.simulation)
        self._observer.restore(state["frames"])
        self._keys, self._draws = state["keys"].copy(), state["draws"].copy()
        self._lengths, self._returns = state["lengths"].copy(), state["returns"].copy()
        self.distances = state["distances"].copy()
        self._rng.bit_generator.state = state["generator"]

    def close(self) -> None:
        """Free what the simulation holds."""
        self.simulation.close()

    def _starts(self, robots: np.ndarray) -> Start:
        """New starts of the robots with these indices, one row each."""
        draws = StreamDraws(self._keys[robots], self._draws[robots])
        start = self.task.begin_varied(self.scene.setup, draws)
        self._draws[robots] = draws.counts
        return start


def infos_of(reading: Reading, robots: np.ndarray, distances: np.ndarray, outcome: Outcome) -> dict[str, np.ndarray]:
    """The infos of robots whose episodes end, by the keys of `TurtleBot2Env`, a row for each.

    Args:
        reading: Of all robots.
        robots: Indices of those that end, shape (n,).
        distances: How far each has driven [m], shape (n,).
        outcome: Of all robots.
    """
    names, failed, success = zip(*outcome.endings(robots), strict=True)
    return {
        "pose": reading.pose[robots],
        "distance": distances,
        "min_range": reading.nearest[robots],
        "bumped": reading.bumped[robots],
        "is_success": np.array(success),
        "ended": np.array(names, dtype=object),
        "failed": np.array(failed),
    }
