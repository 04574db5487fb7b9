"""A policy drives an episode, step by step: what films show, and what evaluations are made of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch as th

from tb2rl.core.errors import InputError
from tb2rl.core.values import Count, checked
from tb2rl.envs.encodings import stacked
from tb2rl.envs.single import TurtleBot2Env
from tb2rl.simulation import InitialState

LARGEST_SEED = 2**32 - 1


class Policy(Protocol):
    """What drives: anything with Stable-Baselines3's `predict`."""

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[np.ndarray, Any]:
        """The action for an observation, and what a recurrent policy remembers until the next call, else None."""


@dataclass(frozen=True)
class Moment:
    """One control step of an episode."""

    step: int  # its number, from 1
    before: np.ndarray  # the pose that it began at: x [m], y [m], yaw [rad], shape (3,)
    pose: np.ndarray  # the pose that it led to, shape (3,)
    action: np.ndarray  # as the policy gave it: shape () for a named command, (2,) for velocities
    reward: float
    total: float  # rewards since the reset
    info: Mapping[str, Any]  # of `TurtleBot2Env.step`; its "ended" says whether the episode is over, and why
    initial_state: InitialState  # how the episode began: one robot's world, goal and bounds
    # What moves, at its beginning and at its end: outlines as in `RobotState.dynamic_obstacles`, shape (movers, 6);
    # None: nothing.
    dynamic_obstacles_before: np.ndarray | None = None
    dynamic_obstacles: np.ndarray | None = None
    ranges: np.ndarray | None = None  # along the laser's beams at its end [m], shape (beams,)


def time_limit(steps: int | None, settings: Mapping[str, Any], usual: int) -> int:
    """Control steps at most in an episode.

    Args:
        steps: The limit that the caller asks for; None: none.
        settings: Changes to the task by name; `episode_steps` among them is such a limit, too.
        usual: The limit where neither says one.

    Raises:
        InputError: If both say one, or that of the settings is not a number of steps.
    """
    if "episode_steps" not in settings:
        return usual if steps is None else steps
    if steps is not None:
        raise InputError("--steps (steps=) and task.episode_steps set the same time limit; give one of them")
    return checked(Count, settings["episode_steps"], "task.episode_steps")


def roll_out(env: TurtleBot2Env, policy: Policy, seed: int, **options: Any) -> Iterator[Moment]:
    """One episode of the greedy policy.

    Args:
        env: Where it drives.
        policy: What drives.
        seed: Of the noise, of the start pose unless one is given, and of a policy that draws.
        options: Of `TurtleBot2Env.reset`: how it begins, where that is not drawn.

    Raises:
        InputError: If the pose is inside a wall, or the policy gives an action that does not exist.
    """
    with _drawing_from(seed):
        episode = _Episode(env, seed, **options)
        remembered: dict[str, Any] = {}  # by a recurrent policy; others do not know the argument
        while not episode.over:
            action, memory = policy.predict(episode.observation, deterministic=True, **remembered)
            remembered = {} if memory is None else {"state": memory}
            yield episode.step(action)


def roll_out_together(
    envs: Sequence[TurtleBot2Env], policy: Policy, seeds: Sequence[int], starts: Sequence[InitialState]
) -> list[list[Moment]]:
    """One episode in each of several environments, as by `roll_out`, but the policy is asked for all of them at once.

    For a network that is hardly more work than for one.

    Args:
        envs: Where it drives, one for each episode.
        policy: What drives; it predicts for several robots at once, as those of Stable-Baselines3 do.
        seeds: Of the noise of each episode; the first also of a policy that draws.
        starts: How each begins, one robot in each.
    """
    with _drawing_from(seeds[0]):
        episodes = [
            _Episode(env, seed, initial_state=initial_state)
            for env, seed, initial_state in zip(envs, seeds, starts, strict=True)
        ]
        moments: list[list[Moment]] = [[] for _ in episodes]
        remembered: dict[str, Any] = {}
        while not all(episode.over for episode in episodes):
            observations = stacked([episode.observation for episode in episodes])
            actions, memory = policy.predict(observations, deterministic=True, **remembered)
            remembered = {} if memory is None else {"state": memory}
            for episode, action, driven in zip(episodes, actions, moments, strict=True):
                if not episode.over:
                    driven.append(episode.step(action))
    return moments


class _Episode:
    """An episode under way."""

    def __init__(self, env: TurtleBot2Env, seed: int, **options: Any) -> None:
        self._env = env
        self.observation, self._info = env.reset(seed=seed, options=options)
        self._steps, self._total, self.over = 0, 0.0, False

    def step(self, action: Any) -> Moment:
        """The next moment of it."""
        before, dynamic_obstacles_before = self._info["pose"], _dynamic_obstacles(self._env)
        self.observation, reward, terminated, truncated, info = self._env.step(action)
        self._info, self._steps, self._total = info, self._steps + 1, self._total + float(reward)
        self.over = terminated or truncated
        robot_state = self._env.robot_state
        assert robot_state is not None
        read = dynamic_obstacles_before, _dynamic_obstacles(self._env), robot_state.ranges[0]
        done = np.asarray(action), float(reward), self._total
        return Moment(self._steps, before, info["pose"], *done, info, robot_state.initial_state, *read)


@contextmanager
def _drawing_from(seed: int) -> Iterator[None]:
    """A policy that draws, draws the same whatever happened before."""
    with th.random.fork_rng(devices=[]):
        th.manual_seed(seed)
        yield


def _dynamic_obstacles(env: TurtleBot2Env) -> np.ndarray | None:
    robot_state = env.robot_state
    return None if robot_state is None or robot_state.dynamic_obstacles is None else robot_state.dynamic_obstacles[0]
