"""Thousands of robots as one Stable-Baselines3 `VecEnv`, over the kinematic simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from tb2rl.envs import info_of
from tb2rl.observations import prepare
from tb2rl.robot import BASE_RADIUS
from tb2rl.simulation import Reading
from tb2rl.simulation.kinematic import KinematicSimulation
from tb2rl.streams import uniforms
from tb2rl.tasks import Outcome, Task


class BatchVecEnv(VecEnv):
    """N robots at one task, advanced together: no object for each, and no Python for each but where an episode ends.

    Robots begin anew by themselves; `infos` are empty but for an episode's end, where they hold what `TurtleBot2Env`
    reports and what Stable-Baselines3 expects: `terminal_observation`, `TimeLimit.truncated` and `episode`. Each robot
    draws its start poses and its laser's noise from streams of its own, so what it meets depends on the seed and on
    itself, not on how many others there are nor on threads.

    Args:
        task: What they do.
        observation: "discrete" or "raw".
        robots: How many.
        reward_scale: Of the rewards that `step` returns; `episode` holds the unscaled return.
    """

    def __init__(self, task: Task, observation: str, robots: int, reward_scale: float = 1.0) -> None:
        self.maze, self.task, self._observe, self.laser = prepare(task, observation)
        self._commands = self.task.commands
        self.simulation = KinematicSimulation(self.maze, self.laser, robots)
        self.maze.free_space(self.task.start_clearance if self.task.start == "random" else BASE_RADIUS)
        self.render_mode = None
        self.reward_scale = reward_scale
        super().__init__(robots, self._observe.space, gym.spaces.Discrete(len(self._commands)))
        self._rng = np.random.default_rng()
        self._nothing: list[dict[str, Any]] = [{} for _ in range(robots)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self._rng = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> VecEnvObs:
        robots = self.num_envs
        starts, noise = self._rng.spawn(2)
        self._keys = starts.integers(2**64, size=robots, dtype=np.uint64)
        self._draws = np.zeros(robots, dtype=np.uint64)
        self._lengths = np.zeros(robots, dtype=np.int64)
        self._returns, self._distances = np.zeros(robots), np.zeros(robots)
        self._reading = self.simulation.reset(self._start_poses(np.arange(robots)), noise)
        return self._observe(self._reading)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = np.asarray(actions)

    def step_wait(self) -> VecEnvStepReturn:
        before = self._reading
        after = self.simulation.step(self._commands.take(self._actions, axis=0), self.task.control_period)
        outcome = self.task.judge(before, self._actions, after)
        terminated = outcome.terminated
        self._lengths += 1
        self._returns += outcome.reward
        self._distances += np.hypot(after.pose[:, 0] - before.pose[:, 0], after.pose[:, 1] - before.pose[:, 1])
        dones = terminated | (self._lengths >= self.task.episode_steps)
        observations = self._observe(after)
        infos = self._nothing
        ended = np.flatnonzero(dones)
        if ended.size:
            infos = infos.copy()
            for robot in ended.tolist():
                infos[robot] = self._report(robot, observations[robot].copy(), outcome, after)
            self._lengths[ended], self._returns[ended], self._distances[ended] = 0, 0.0, 0.0
            after = self.simulation.place(ended, self._start_poses(ended), after)
            observations[ended] = self._observe(some_of(after, ended))
        self._reading = after
        return observations, (self.reward_scale * outcome.reward).astype(np.float32), dones, infos

    def state(self) -> dict[str, Any]:
        """All that the rest of the episodes and later ones depend on, in plain values and arrays."""
        return {
            "simulation": asdict(self.simulation.state()),
            "reading": asdict(self._reading),
            "keys": self._keys.copy(),
            "draws": self._draws.copy(),
            "lengths": self._lengths.copy(),
            "returns": self._returns.copy(),
            "distances": self._distances.copy(),
            "generator": self._rng.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state` as if nothing had happened since.

        Raises:
            ValueError: If it is one of another number of robots or beams.
        """
        sizes = self.num_envs, len(self.laser.angles)
        if state["reading"]["ranges"].shape != sizes or any(len(a) != sizes[0] for a in state["simulation"].values()):
            raise ValueError(f"the state is not one of {sizes[0]} robots with {sizes[1]} beams")
        self.simulation.restore(self.simulation.state_type(**state["simulation"]))
        self._reading = Reading(**state["reading"])
        self._keys, self._draws = state["keys"].copy(), state["draws"].copy()
        self._lengths, self._returns = state["lengths"].copy(), state["returns"].copy()
        self._distances = state["distances"].copy()
        self._rng.bit_generator.state = state["generator"]

    def close(self) -> None:
        self.simulation.close()

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        raise NotImplementedError("the robots of a batch share their attributes; make another BatchVecEnv")

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        raise NotImplementedError(f"the robots of a batch have no methods of their own, such as {method_name}")

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        reports_episodes = wrapper_class.__name__ == "Monitor"  # what evaluate_policy asks for
        return [reports_episodes for _ in self._get_indices(indices)]

    def _start_poses(self, robots: np.ndarray) -> np.ndarray:
        if self.task.start == "fixed":
            return np.tile(self.maze.start, (len(robots), 1))
        keys, draws = self._keys[robots], self._draws[robots]
        numbers = np.empty((len(robots), 4))
        uniforms(keys, draws, numbers)
        self._draws[robots] = draws
        return self.maze.poses_from(numbers, self.task.start_clearance)

    def _report(self, robot: int, observation: np.ndarray, outcome: Outcome, after: Reading) -> dict[str, Any]:
        ended = outcome.ending(robot, timed_out=True)
        distance = float(self._distances[robot])
        return {
            **info_of(after, robot, distance, outcome.succeeded(robot, ended), ended),
            "pose": after.pose[robot].copy(),
            "terminal_observation": observation,
            "TimeLimit.truncated": ended == "time limit",
            "episode": {"r": float(self._returns[robot]), "l": int(self._lengths[robot]), "t": 0.0},
        }


def some_of(reading: Reading, robots: np.ndarray) -> Reading:
    """The rows of a reading that belong to some robots."""
    return Reading(
        reading.pose[robots],
        reading.twist[robots],
        reading.odometry[robots],
        reading.ranges[robots],
        reading.bumped[robots],
    )
