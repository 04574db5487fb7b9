"""Episodes of a policy, in the slots of a control loop: a free slot takes the next episode of the queue.

An episode depends on its seed and number alone, not on slots, processes or other episodes. Evaluations, suites, films
and tuning all run here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np
import torch as th
from annotated_types import Ge
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.core.compiled import njit
from tb2rl.envs.control_loop import ControlLoop, Transition
from tb2rl.envs.encodings import Observations, rows
from tb2rl.simulation import InitialState, RobotState
from tb2rl.worlds.geometry import clearance_at

# A network is asked for at least so many observations at once: then the rounding of an action depends neither on the
# number nor on the order of the others. Smaller matrix products take other code (measured: 1 and 2 rows differ).
_ROWS = 8


class Policy(Protocol):
    """Anything with Stable-Baselines3's `predict`."""

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[np.ndarray, Any]:
        """The action for an observation, and the state of a recurrent policy for the next call, else None."""


@dataclass(frozen=True)
class EpisodeStart:
    """How an episode starts.

    Attributes:
        number: In its evaluation, from 0.
        seed: Of a policy that draws random numbers.
        initial_state: One row.
        rng: Source of its sensor noise; used up by the episode.
    """

    number: int
    seed: int
    initial_state: InitialState
    rng: np.random.Generator


@dataclass(frozen=True)
class Step:
    """One control step of the episodes in all slots; arrays have a row for each slot.

    Attributes:
        episodes: In the slots; None: the slot is free.
        before: The state that the actions answer to.
        actions: Of the policy, shape (slots, ...).
        transition: What came of it.
        after: The state that it led to.
    """

    episodes: list[EpisodeStart | None]
    before: RobotState
    actions: np.ndarray
    transition: Transition
    after: RobotState


@dataclass(frozen=True)
class Episode:
    """One episode; its return and distance are sums over its steps."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    ended: str  # "collision", "goal", ..., "time limit"
    failed: bool  # whether that ending counts as failed
    success: bool
    touched: bool  # whether the bumper was pressed
    length: int  # control steps
    distance: float  # [m]
    episode_return: float
    path: np.ndarray  # x, y [m] at the start and after each step, shape (length + 1, 2), float32
    actions: np.ndarray  # of each step: shape (length,), whole numbers, or (length, 2), float32
    world: Annotated[int, Ge(0)] = 0  # index among those of the scene
    closest: float | None = None  # [m] smallest gap between hull and obstacles; None: not measured
    goal: tuple[float, float] | None = None  # x, y [m]; None: the task has none


def slots_for(policy: Policy, most: int) -> int:
    """Number of episodes that a policy can drive at once: one if it is not of Stable-Baselines3, because only those
    predict for several observations.
    """
    return most if isinstance(policy, BasePolicy) else 1


def run_steps(loop: ControlLoop, policy: Policy, episodes: Iterable[EpisodeStart]) -> Iterator[Step]:
    """Drive episodes with the greedy policy, and give each control step before finished slots take the next episode.

    Args:
        loop: Its environments are the slots.
        policy: A policy that predicts for one observation only needs a loop with one slot.
        episodes: The queue.

    Raises:
        InputError: If such a policy gives an action that does not exist.
    """
    queue = deque(episodes)
    if not queue:
        return
    waiting = queue[0]  # stands in slots for which there is no episode
    slots: list[EpisodeStart | None] = [queue.popleft() if queue else None for _ in range(loop.num_envs)]
    starts = [each or waiting for each in slots]
    with th.random.fork_rng(devices=[]):
        th.manual_seed(starts[0].seed)
        observations = loop.reset(_stacked(starts), [each.rng for each in starts])
        predict = _Predictor(policy, loop)
        while any(slots):
            before, actions = loop.robot_state, predict(observations)
            free = np.array([each is None for each in slots])
            transition = loop.step(actions, free if free.any() else None)
            observations = transition.observations
            yield Step(list(slots), before, actions, transition, loop.robot_state)
            if transition.finished is None:
                continue
            indices = transition.finished.indices
            for i in indices:
                slots[i] = queue.popleft() if queue else None
            following = [(i, slots[i]) for i in indices if slots[i] is not None]
            if following:
                taken, starts = np.array([i for i, _ in following]), [start for _, start in following if start]
                loop.reset_at(taken, _stacked(starts), observations, [each.rng for each in starts])
                predict.restart(taken, starts[0].seed)


def run_episodes(
    loop: ControlLoop, policy: Policy, episodes: Iterable[EpisodeStart], by_laser: bool = False
) -> Iterator[tuple[int, Episode]]:
    """Drive episodes, and give number and record of each as it ends; `by_laser` see `Recorder`."""
    recorder = Recorder(loop, by_laser)
    for step in run_steps(loop, policy, episodes):
        yield from recorder.record(step)


def draws_random_numbers(policy: Policy, observation_space: spaces.Space) -> bool:
    """Whether a policy draws from torch's generator to act; then it can drive only one episode at a time."""
    with th.random.fork_rng(devices=[]):
        before = th.get_rng_state()
        policy.predict(observation_space.sample(), deterministic=True)
        return not th.equal(before, th.get_rng_state())


class Recorder:
    """Records the episodes of a loop as `run_steps` drives them.

    Args:
        loop: The loop.
        by_laser: Whether `closest` comes from the laser, because the surroundings of a real robot are unknown.
    """

    def __init__(self, loop: ControlLoop, by_laser: bool = False) -> None:
        self._scene, slots, steps = loop.scene, loop.num_envs, loop.task.episode_steps
        self._by_laser, self._nearest = by_laser, np.full(slots, np.inf)
        self._paths = np.empty((slots, steps + 1, 2))
        space = loop.scene.action_space
        self._actions = np.empty((slots, steps, *(space.shape or ())), smallest_type(space))
        self._touched = np.zeros(slots, dtype=bool)
        self._lengths = np.zeros(slots, dtype=np.int64)
        self._starts = np.empty((slots, 3))

    def record(self, step: Step) -> Iterator[tuple[int, Episode]]:
        """Take in a step, and give the number and the record of each episode that ended in it."""
        slots, lengths = np.arange(len(self._lengths)), self._lengths
        first = lengths == 0
        if first.any():
            self._starts[first], self._paths[first, 0] = step.before.pose[first], step.before.pose[first, :2]
        busy = np.array([each is not None for each in step.episodes])
        self._actions[slots[busy], lengths[busy]] = np.asarray(step.actions)[busy]
        lengths[busy] += 1
        self._paths[slots[busy], lengths[busy]] = step.after.pose[busy, :2]
        self._touched |= step.after.bumped & busy
        self._nearest = np.minimum(self._nearest, step.after.nearest)
        finished = step.transition.finished
        if finished is not None:
            for row, slot in enumerate(finished.indices):
                episode = step.episodes[slot]
                assert episode is not None  # a free slot finishes nothing
                yield episode.number, self._episode(step, row, int(slot))
                self._lengths[slot], self._touched[slot], self._nearest[slot] = 0, False, np.inf

    def _episode(self, step: Step, row: int, slot: int) -> Episode:
        finished, initial_state = step.transition.finished, step.after.initial_state
        assert finished is not None
        infos, length = finished.infos, int(finished.lengths[row])
        path, world = self._paths[slot, : length + 1], int(initial_state.world[slot])
        clearance = self._nearest[slot]
        if not self._by_laser:
            clearance = _smallest_clearance(path, self._scene.spec.worlds[world].index)
        radius = float(initial_state.rows["radius"][slot])
        goal = tuple(initial_state.goal[slot].tolist()) if self._scene.task.goal_task else None
        return Episode(
            start=tuple(self._starts[slot].tolist()),
            ended=infos["ended"][row],
            failed=bool(infos["failed"][row]),
            success=bool(infos["is_success"][row]),
            touched=bool(self._touched[slot]),
            length=length,
            distance=float(infos["distance"][row]),
            episode_return=float(finished.returns[row]),
            path=path.astype(np.float32),
            actions=self._actions[slot, :length].copy(),
            world=world,
            closest=max(clearance - radius, 0.0) if np.isfinite(clearance) else None,  # inf: there is no obstacle
            goal=goal,
        )


class _Predictor:
    """Asks a policy for the actions of all slots, and keeps its recurrent state."""

    def __init__(self, policy: Policy, loop: ControlLoop) -> None:
        self._policy, self._batched = policy, isinstance(policy, BasePolicy)
        self._actions, slots = loop.scene.actions, loop.num_envs
        self._rows = np.arange(max(slots, _ROWS)) % slots  # slots that fill the batch
        self._slots = slots
        self._state: Any = None
        self._restarted = np.zeros(len(self._rows), dtype=bool)

    def __call__(self, observations: Observations) -> np.ndarray:
        if not self._batched:
            memory = {} if self._state is None else {"state": self._state}
            action, self._state = self._policy.predict(rows(observations, 0), deterministic=True, **memory)
            return self._actions.checked(action)
        recurrent = {} if self._state is None else {"state": self._state, "episode_start": self._restarted}
        batch = rows(observations, self._rows)
        actions, self._state = self._policy.predict(batch, deterministic=True, **recurrent)
        self._restarted = np.zeros(len(self._rows), dtype=bool)
        return actions[: self._slots]

    def restart(self, slots: np.ndarray, seed: int) -> None:
        """Forget the recurrent state of slots whose episode starts; with one slot, seed what the policy draws."""
        self._restarted |= np.isin(self._rows, slots)
        if self._slots == 1:
            th.manual_seed(seed)
            self._state = None


def _stacked(starts: Iterable[EpisodeStart]) -> InitialState:
    return InitialState(np.concatenate([each.initial_state.table for each in starts]))


def smallest_type(space: spaces.Space) -> np.dtype:
    """The smallest integers that hold all named commands, or the type of the velocities."""
    return np.min_scalar_type(int(space.n) - 1) if isinstance(space, spaces.Discrete) else np.dtype(space.dtype)


@njit(cache=True)
def _smallest_clearance(points, index):
    """The smallest distance from points (n, 2) to the obstacles of a world [m]."""
    smallest = np.inf
    for i in range(points.shape[0]):
        smallest = min(smallest, clearance_at(points[i, 0], points[i, 1], index, 0))
    return smallest
