"""Runs episodes of a policy in the environments of a control loop.

Each environment is a slot: when its episode ends, it takes the next episode of a queue. An episode depends only on the
seed of the evaluation and on the episode's number, not on the slot, the process, or other episodes.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, Any, Protocol

import numpy as np
import torch as th
from annotated_types import Ge
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.core.compiled import njit
from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.control_loop import ControlLoop, FinishedEpisodes, Transition
from tb2rl.envs.encodings import Observations, take_rows
from tb2rl.envs.scene import Scene
from tb2rl.simulation import InitialState, RobotState
from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.worlds.geometry import clearance_at

# Minimum number of rows of a prediction; smaller batches are padded. Without padding, an action would depend on the
# number of slots, because matrix products of 1 or 2 rows round differently.
_MIN_BATCH_SIZE = 8
LARGEST_SEED = 2**32 - 1


class Policy(Protocol):
    """An object with Stable-Baselines3's `predict`."""

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[np.ndarray, Any]:
        """The action for an observation, and the new state of a recurrent policy (None for other policies)."""


@dataclass(frozen=True)
class EpisodeStart:
    """The seed and the initial state of an episode."""

    number: int  # index of the episode in its evaluation
    seed: int  # for a policy that draws random numbers
    initial_state: InitialState  # one row
    rng: np.random.Generator  # source of the sensor noise; the episode advances it


@dataclass(frozen=True)
class LoopStep:
    """One control step of a control loop; arrays have one row for each slot."""

    episode_numbers: np.ndarray  # `EpisodeStart.number` of the episode in each slot; -1 for a free slot
    before: RobotState  # state before the step
    actions: np.ndarray  # actions of the policy, shape (slots, ...)
    transition: Transition  # rewards and endings; the state after the step is `ControlLoop.robot_state`


@dataclass(frozen=True)
class EpisodeStep:
    """One control step of an episode."""

    number: int  # 1 for the first step
    before: RobotState  # state before the step, one row
    after: RobotState  # state after the step, one row
    action: np.ndarray  # action of the policy: shape () for a named command, (2,) for velocities
    reward: float
    episode_return: float  # sum of the rewards since the reset
    info: Mapping[str, Any]  # as from `TurtleBot2Env.step`; "ended" is empty before the last step
    command: np.ndarray | None = None  # command after the filters, v [m/s] and w [rad/s], shape (2,)
    intervention: str = ""  # why filters changed the command; empty if they did not, or do not say


@dataclass(frozen=True)
class Episode:
    """The record of an episode."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    ended: str  # "collision", "goal", ..., "time limit"
    failed: bool  # whether the ending is a failure
    success: bool  # whether the ending is a success
    touched: bool  # whether the bumper was pressed
    length: int  # [control steps]
    distance: float  # [m] length of the path
    episode_return: float
    path: np.ndarray  # x, y [m] at the start and after each step, shape (length + 1, 2), float32
    actions: np.ndarray  # action of each step, shape (length,), integers, or (length, 2), float32
    world: Annotated[int, Ge(0)] = 0  # index in the worlds of the scene
    min_clearance: float | None = None  # [m] smallest gap from hull to obstacles, see `run_episodes`; None: no obstacle
    goal: tuple[float, float] | None = None  # x, y [m]; None: a task without a goal
    filtered_share: float = 0.0  # [%] control steps in which filters changed the command


def check_spaces(policy: Any, scene: Scene) -> None:
    """Raise an `InputError` if the observation or action space of a policy differs from that of a scene."""
    for name, space in (("observation", scene.observation_space), ("action", scene.action_space)):
        policy_space = getattr(policy, f"{name}_space", space)
        if policy_space != space:
            message = f"the policy has the {name} space {one_line(policy_space, 150)}"
            raise InputError(f"{message}, but this task has {one_line(space, 150)}")


def run_steps(loop: ControlLoop, policy: Policy, episodes: Iterable[EpisodeStart]) -> Iterator[LoopStep]:
    """Run episodes with greedy actions, and yield each control step before the loop resets finished episodes.

    Args:
        loop: The control loop, whose environments are the slots.
        policy: A `BasePolicy` predicts for all slots at once; any other policy needs a loop with one slot.
        episodes: The queue of episodes.

    Raises:
        InputError: If a policy that is not a `BasePolicy` returns an invalid action.
    """
    queue = iter(episodes)
    starts = list(islice(queue, loop.num_envs))
    if not starts:
        return
    episode_numbers = np.full(loop.num_envs, -1)
    episode_numbers[: len(starts)] = [start.number for start in starts]
    starts += starts[:1] * (loop.num_envs - len(starts))  # a free slot needs some initial state
    with th.random.fork_rng(devices=[]):
        th.manual_seed(starts[0].seed)
        observations = loop.reset(_stack_initial_states(starts), [start.rng for start in starts])
        predictor = _Predictor(policy, loop)
        while (episode_numbers >= 0).any():
            before, actions = loop.robot_state, predictor.predict(observations)
            is_free = episode_numbers < 0
            transition = loop.step(actions, inactive=is_free if is_free.any() else None)
            observations = transition.observations
            yield LoopStep(episode_numbers.copy(), before, actions, transition)
            if transition.finished is None:
                continue
            finished_slots = transition.finished.indices
            episode_numbers[finished_slots] = -1
            if starts := list(islice(queue, len(finished_slots))):
                restarted_slots = finished_slots[: len(starts)]
                episode_numbers[restarted_slots] = [start.number for start in starts]
                rngs = [start.rng for start in starts]
                # This also overwrites the rows of these slots in `observations`.
                loop.reset_at(restarted_slots, _stack_initial_states(starts), observations, rngs)
                predictor.restart(restarted_slots, starts[0].seed)


def roll_out(loop: ControlLoop, policy: Policy, seed: int) -> Iterator[EpisodeStep]:
    """Run one greedy episode, the same as in `TurtleBot2Env` after `reset(seed=seed)`, and yield its control steps.

    Args:
        loop: A control loop with one environment.
        policy: The policy.
        seed: Seed of the initial state, of the noise, and of a policy that draws random numbers.

    Raises:
        InputError: If the policy returns an invalid action.
    """
    rng = np.random.default_rng(seed)
    initial_state = loop.task.randomized_initial_state(loop.scene.spec, GeneratorSource(rng))
    return run_single(loop, policy, EpisodeStart(0, seed, initial_state, rng))


def run_single(loop: ControlLoop, policy: Policy, start: EpisodeStart) -> Iterator[EpisodeStep]:
    """Run one episode with greedy actions from a given start, and yield its control steps."""
    episode_return = 0.0
    for number, step in enumerate(run_steps(loop, policy, [start]), start=1):
        finished, reward = step.transition.finished, float(step.transition.reward[0])
        episode_return += reward
        info = {key: column[0] for key, column in (finished.infos if finished else loop.infos()).items()}
        values = step.actions[0], reward, episode_return, info, loop.commands[0], loop.intervention(0)
        yield EpisodeStep(number, step.before, loop.robot_state, *values)


def run_episodes(
    loop: ControlLoop, policy: Policy, episodes: Iterable[EpisodeStart], clearance_from_laser: bool = False
) -> Iterator[tuple[int, Episode]]:
    """Run episodes, and yield the number and the record of each when it ends.

    Args:
        loop, policy, episodes: As for `run_steps`.
        clearance_from_laser: Whether `min_clearance` comes from the laser ranges, as for a real robot, whose
            obstacles are unknown, or from the static obstacles of the world alone.
    """
    recorder = _Recorder(loop, clearance_from_laser)
    for step in run_steps(loop, policy, episodes):
        yield from recorder.record(step)


class _Recorder:
    """Records the episodes of a control loop."""

    def __init__(self, loop: ControlLoop, clearance_from_laser: bool) -> None:
        self._loop, self._clearance_from_laser = loop, clearance_from_laser
        num_slots, steps, space = loop.num_envs, loop.task.episode_steps, loop.scene.action_space
        self._poses = np.empty((num_slots, steps + 1, 3))
        # The smallest integer type that holds all named commands, or the type of the velocities.
        dtype = np.min_scalar_type(int(space.n) - 1) if isinstance(space, spaces.Discrete) else space.dtype
        self._actions = np.empty((num_slots, steps, *(space.shape or ())), dtype)
        self._touched, self._min_ranges = np.empty(num_slots, dtype=bool), np.empty(num_slots)
        self._filtered_steps = np.zeros(num_slots, dtype=int)

    def record(self, step: LoopStep) -> Iterator[tuple[int, Episode]]:
        """Record a control step, and yield the number and the record of each episode that ends with it."""
        slots, finished = np.flatnonzero(step.episode_numbers >= 0), step.transition.finished
        lengths, after = self._loop.lengths[slots], self._loop.robot_state
        new = slots[lengths == 1]  # slots whose episode began with this step
        self._poses[new, 0], self._touched[new], self._min_ranges[new] = step.before.pose[new], False, np.inf
        self._filtered_steps[new] = 0
        self._poses[slots, lengths] = after.pose[slots]
        self._actions[slots, lengths - 1] = np.asarray(step.actions)[slots]
        self._touched |= after.bumped
        self._filtered_steps += self._loop.is_filtered
        self._min_ranges = np.minimum(self._min_ranges, after.nearest_range)
        if finished:
            for row, slot in enumerate(finished.indices):
                yield int(step.episode_numbers[slot]), self._episode(finished, row, int(slot))

    def _episode(self, finished: FinishedEpisodes, row: int, slot: int) -> Episode:
        initial_state, scene, infos = self._loop.robot_state.initial_state, self._loop.scene, finished.infos
        length, world = int(finished.lengths[row]), int(initial_state.world[slot])
        poses = self._poses[slot, : length + 1]
        path, min_distance = np.ascontiguousarray(poses[:, :2]), self._min_ranges[slot]
        if not self._clearance_from_laser:
            min_distance = _nearest_distance(path, scene.spec.worlds[world].spatial_index)
        clearance = max(min_distance - float(initial_state.records["radius"][slot]), 0.0)
        return Episode(
            start=tuple(poses[0].tolist()),
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
            min_clearance=clearance if np.isfinite(clearance) else None,
            goal=tuple(initial_state.goal[slot].tolist()) if scene.task.goal_task else None,
            filtered_share=100.0 * int(self._filtered_steps[slot]) / length,
        )


class _Predictor:
    """Predicts the actions of all slots, and keeps the state of a recurrent policy."""

    def __init__(self, policy: Policy, loop: ControlLoop) -> None:
        self._policy: Any = policy
        self._actions, self._num_slots = loop.scene.actions, loop.num_envs
        # The slot of each row of a batch; padding repeats slots.
        self._batch_slots = np.arange(max(self._num_slots, _MIN_BATCH_SIZE)) % self._num_slots
        self._recurrent_state: Any = None
        self._restarted = np.zeros(len(self._batch_slots), dtype=bool)

    def predict(self, observations: Observations) -> np.ndarray:
        if isinstance(self._policy, BasePolicy):
            batch = take_rows(observations, self._batch_slots)
            arguments = {"state": self._recurrent_state, "episode_start": self._restarted, "deterministic": True}
            actions, self._recurrent_state = self._policy.predict(batch, **arguments)
            self._restarted = np.zeros(len(self._batch_slots), dtype=bool)
            return actions[: self._num_slots]
        state = {} if self._recurrent_state is None else {"state": self._recurrent_state}
        action, self._recurrent_state = self._policy.predict(take_rows(observations, 0), deterministic=True, **state)
        return self._actions.checked(action)

    def restart(self, slots: np.ndarray, seed: int) -> None:
        """Reset the recurrent state of slots that start an episode; seed torch, too, if there is a single slot."""
        self._restarted |= np.isin(self._batch_slots, slots)
        if self._num_slots == 1:
            th.manual_seed(seed)
            self._recurrent_state = None


def _stack_initial_states(starts: Iterable[EpisodeStart]) -> InitialState:
    return InitialState(np.concatenate([start.initial_state.table for start in starts]))


@njit(cache=True)
def _nearest_distance(points, spatial_index):
    """The smallest distance from points (n, 2) to the obstacles of a world [m]; inf without obstacles."""
    smallest = np.inf
    for i in range(points.shape[0]):
        smallest = min(smallest, clearance_at(points[i, 0], points[i, 1], spatial_index, 0))  # 0: the only world
    return smallest
