"""What a policy does from many start poses, and the figures that say how good that is."""

from __future__ import annotations

import math
import pickle
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cloudpickle
import numpy as np
import torch as th

from tb2rl.envs import TurtleBot2Env
from tb2rl.maze import load_maze
from tb2rl.processes import process_context, processors
from tb2rl.tasks import Task

EPISODES, STEPS = 100, 1500
SEED = 20_180_000  # of the standard start poses; trainings with small seeds never draw them
TRAINING_SEED = 20_190_000  # of the evaluations while training


class Policy(Protocol):
    """What is evaluated: anything with Stable-Baselines3's `predict`."""

    def predict(self, observation: np.ndarray, *, deterministic: bool = False) -> tuple[np.ndarray, Any]:
        """Action and state for an observation."""


@dataclass(frozen=True)
class Episode:
    """One evaluated episode; the return and the distance are sums over its steps."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    ended: str  # "crash", "goal", ..., "time limit"
    success: bool
    touched: bool  # whether the bumper fired
    length: int  # control steps
    distance: float  # [m]
    episode_return: float
    path: np.ndarray  # x, y [m] after each step, shape (length + 1, 2), float32


@dataclass(frozen=True)
class Evaluation:
    """What a policy did, and what it was asked to do."""

    episodes: Sequence[Episode]
    task: Task
    steps: int
    seed: int

    def summary(self) -> dict[str, Any]:
        """The figures, for a table or a JSON file; speeds in m/s, distances in m, rates with 95 % intervals."""
        episodes, seconds = self.episodes, self.task.control_period
        crash_free = [episode.ended != "crash" for episode in episodes]
        success = [episode.success for episode in episodes]
        lengths = [episode.length for episode in episodes]
        distances = [episode.distance for episode in episodes]
        returns = [episode.episode_return for episode in episodes]
        return {
            "episodes": len(episodes),
            "steps": self.steps,
            "seed": self.seed,
            "crash_free_rate": float(np.mean(crash_free)),
            "crash_free_interval": wilson_interval(sum(crash_free), len(episodes)),
            "success_rate": float(np.mean(success)),
            "success_interval": wilson_interval(sum(success), len(episodes)),
            "touch_free_rate": float(np.mean([not episode.touched for episode in episodes])),
            "mean_distance": float(np.mean(distances)),
            "std_distance": float(np.std(distances)),
            "mean_return": float(np.mean(returns)),
            "std_return": float(np.std(returns)),
            "mean_length": float(np.mean(lengths)),
            "std_length": float(np.std(lengths)),
            "mean_speed": sum(distances) / (sum(lengths) * seconds),
            "endings": {
                ended: sum(e.ended == ended for e in episodes) for ended in sorted({e.ended for e in episodes})
            },
        }

    @property
    def score(self) -> tuple[float, float]:
        """What makes one evaluation better than another: the success rate, then the mean return."""
        return float(np.mean([e.success for e in self.episodes])), float(
            np.mean([e.episode_return for e in self.episodes])
        )


class Evaluator:
    """Worlds that stand ready to evaluate policies, spread over processes.

    Args:
        task: What to do; its start poses and time limit are replaced.
        observation: "discrete" or "raw".
        episodes: How many, each from a start pose of its own.
        steps: Control steps at most in an episode.
        seed: Of the start poses and of all noise.
        workers: Processes; None: one for each processor, 1: none but this one.
    """

    def __init__(
        self,
        task: Task,
        observation: str,
        episodes: int = EPISODES,
        steps: int = STEPS,
        seed: int = SEED,
        workers: int | None = None,
    ) -> None:
        self.task, self.observation, self.steps, self.seed = (
            replace(task, episode_steps=steps),
            observation,
            steps,
            seed,
        )
        maze = load_maze(task.maze)
        self.poses = maze.random_poses(np.random.default_rng(seed), episodes, task.start_clearance)
        workers = min(workers or processors(), episodes)
        self._pool = None
        if workers > 1:
            world = (cloudpickle.dumps(self.task), observation)
            self._pool = ProcessPoolExecutor(workers, process_context(), initializer=_open_world, initargs=world)
            self._chunks = np.array_split(np.arange(episodes), min(4 * workers, episodes))

    def run(self, policy: Policy) -> Evaluation:
        """Drive all episodes."""
        if self._pool is None:
            env = TurtleBot2Env(self.task, self.observation)
            episodes = [drive(env, policy, pose, self.seed + i) for i, pose in enumerate(self.poses)]
            env.close()
        else:
            data = cloudpickle.dumps(policy)
            jobs = [
                self._pool.submit(_drive_some, data, self.poses[chunk], self.seed + chunk) for chunk in self._chunks
            ]
            episodes = [episode for job in jobs for episode in job.result()]
        return Evaluation(episodes, self.task, self.steps, self.seed)

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Evaluator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def drive(env: TurtleBot2Env, policy: Policy, pose: np.ndarray, seed: int) -> Episode:
    """One episode of the greedy policy from `pose` (x, y, yaw)."""
    with th.random.fork_rng(devices=[]):  # a policy that draws, draws the same whoever drives the episode
        th.manual_seed(seed)
        observation, info = env.reset(seed=seed, options={"pose": tuple(pose)})
        path, total, touched, over = [info["pose"][:2]], 0.0, False, False
        while not over:
            action, _ = policy.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, info = env.step(int(action))
            path.append(info["pose"][:2])
            total += float(reward)
            touched = touched or info["bumped"]
            over = terminated or truncated
    return Episode(
        start=tuple(pose.tolist()),
        ended=info["ended"],
        success=info["is_success"],
        touched=touched,
        length=len(path) - 1,
        distance=info["distance"],
        episode_return=total,
        path=np.array(path, dtype=np.float32),
    )


def wilson_interval(count: int, total: int, z: float = 1.959964) -> tuple[float, float]:
    """The 95 % interval of a rate (Wilson 1927): honest near 0 and 1, where the usual one is not."""
    rate, spread = count / total, z * z / total
    centre = (rate + spread / 2) / (1 + spread)
    half = z / (1 + spread) * math.sqrt(rate * (1 - rate) / total + spread / (4 * total))
    return max(0.0, centre - half), min(1.0, centre + half)


_world: TurtleBot2Env  # of a worker process


def _open_world(task: bytes, observation: str) -> None:
    global _world
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the one that asked decides
    th.set_num_threads(1)
    _world = TurtleBot2Env(pickle.loads(task), observation)


def _drive_some(policy: bytes, poses: np.ndarray, seeds: np.ndarray) -> list[Episode]:
    loaded = pickle.loads(policy)
    return [drive(_world, loaded, pose, int(seed)) for pose, seed in zip(poses, seeds, strict=True)]
