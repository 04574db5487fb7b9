"""A policy drives an episode, step by step: what films show, and what evaluations are made of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch as th

from tb2rl.envs.single import TurtleBot2Env
from tb2rl.simulation import Start

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
    start: Start  # how the episode began: one robot's world, goal and bounds
    # What moves, at its beginning and at its end: outlines as in `Reading.movers`, shape (movers, 6); None: nothing.
    movers_before: np.ndarray | None = None
    movers: np.ndarray | None = None


def roll_out(
    env: TurtleBot2Env, policy: Policy, seed: int, pose: np.ndarray | None = None, world: int | None = None
) -> Iterator[Moment]:
    """One episode of the greedy policy.

    Args:
        env: Where it drives.
        policy: What drives.
        seed: Of the noise, of the start pose unless one is given, and of a policy that draws.
        pose: Where it starts: x [m], y [m], yaw [rad], shape (3,); None: where the task says.
        world: Index of the world that it is in; None: the one that the task draws.

    Raises:
        InputError: If the pose is inside a wall, or the policy gives an action that does not exist.
    """
    with th.random.fork_rng(devices=[]):  # a policy that draws, draws the same whatever happened before
        th.manual_seed(seed)
        options = {"world": world} if pose is None else {"world": world, "pose": tuple(pose)}
        observation, info = env.reset(seed=seed, options=options)
        step, total, over = 0, 0.0, False
        remembered: dict[str, Any] = {}  # by a recurrent policy; others do not know the argument
        while not over:
            before, movers_before, step = info["pose"], _movers(env), step + 1
            action, memory = policy.predict(observation, deterministic=True, **remembered)
            remembered = {} if memory is None else {"state": memory}
            observation, reward, terminated, truncated, info = env.step(action)
            total += float(reward)
            over = terminated or truncated
            start = env.reading.start  # type: ignore[union-attr]
            moving = movers_before, _movers(env)
            yield Moment(step, before, info["pose"], np.asarray(action), float(reward), total, info, start, *moving)


def _movers(env: TurtleBot2Env) -> np.ndarray | None:
    reading = env.reading
    return None if reading is None or reading.movers is None else reading.movers[0]
