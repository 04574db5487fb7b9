"""A policy drives an episode: what films show, and what evaluations judge."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch as th

from tb2rl.envs import TurtleBot2Env

LARGEST_SEED = 2**32 - 1


class Policy(Protocol):
    """What drives: anything with Stable-Baselines3's `predict`."""

    def predict(self, observation: np.ndarray, *, deterministic: bool = False) -> tuple[np.ndarray, Any]:
        """Action and state for an observation."""


@dataclass(frozen=True)
class Moment:
    """One control step of an episode."""

    step: int  # its number, from 1
    before: np.ndarray  # the pose that it began at, shape (3,)
    pose: np.ndarray  # the pose that it led to
    action: int
    reward: float
    total: float  # rewards since the reset
    info: Mapping[str, Any]  # of `TurtleBot2Env.step`; its "ended" says whether the episode is over, and why


def drive(env: TurtleBot2Env, policy: Policy, seed: int, pose: np.ndarray | None = None) -> Iterator[Moment]:
    """One episode of the greedy policy.

    Args:
        env: Where it drives.
        policy: What drives.
        seed: Of the noise, of the start pose unless one is given, and of a policy that draws.
        pose: Where it starts: x [m], y [m], yaw [rad], shape (3,); None: a random pose.
    """
    with th.random.fork_rng(devices=[]):  # a policy that draws, draws the same whatever happened before
        th.manual_seed(seed)
        observation, info = env.reset(seed=seed, options=None if pose is None else {"pose": tuple(pose)})
        step, total, over = 0, 0.0, False
        while not over:
            before, step = info["pose"], step + 1
            action, _ = policy.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, info = env.step(int(action))
            total += float(reward)
            over = terminated or truncated
            yield Moment(step, before, info["pose"], int(action), float(reward), total, info)
