"""Thousands of robots as one Stable-Baselines3 `VecEnv`, over the kinematic simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from tb2rl.envs.encodings import copied_row, put_rows
from tb2rl.envs.scene import Scene
from tb2rl.envs.single import info_of
from tb2rl.simulation import Reading, Start
from tb2rl.simulation.kinematic import KinematicSimulation
from tb2rl.simulation.streams import StreamDraws
from tb2rl.tasks import TIME_LIMIT, Outcome


class BatchVecEnv(VecEnv):
    """N robots at one task, advanced together: no object for each, and no Python for each but where an episode ends.

    Robots begin anew by themselves; `infos` are empty but for an episode's end, where they hold what `TurtleBot2Env`
    reports and what Stable-Baselines3 expects: `terminal_observation`, `TimeLimit.truncated` and `episode`. Each robot
    draws its start poses and its laser's noise from streams of its own, so what it meets depends on the seed and on
    itself, not on how many others there are nor on threads.

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        robots: How many.
        reward_scale: Of the rewards that `step` returns; `episode` holds the unscaled return.
    """

    def __init__(self, scene: Scene, robots: int, reward_scale: float = 1.0) -> None:
        self.scene, self.task = scene, scene.task
        self._observe, self._actions = scene.encoding, scene.actions
        self.simulation = KinematicSimulation(scene.setup, robots)
        self.render_mode = None
        self.reward_scale = reward_scale
        super().__init__(robots, scene.observation_space, scene.action_space)
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
        self._reading = self.simulation.reset(self._starts(np.arange(robots)), noise)
        return self._observe(self._reading)

    def step_async(self, actions: np.ndarray) -> None:
        self._chosen = np.asarray(actions)

    def step_wait(self) -> VecEnvStepReturn:
        before = self._reading
        after = self.simulation.step(self._actions.commands(self._chosen), self.task.control_period)
        outcome = self.task.judge(before, self._chosen, after)
        terminated = outcome.terminated
        self._lengths += 1
        self._returns += outcome.reward
        moved = after.pose - before.pose
        self._distances += np.hypot(moved[:, 0], moved[:, 1])
        dones = terminated | (self._lengths >= self.task.episode_steps)
        observations = self._observe(after)
        infos = self._nothing
        ended = dones.nonzero()[0]
        if ended.size:
            infos = infos.copy()
            for robot in ended.tolist():
                infos[robot] = self._report(robot, outcome, after)
                infos[robot]["terminal_observation"] = copied_row(observations, robot)
            self._lengths[ended], self._returns[ended], self._distances[ended] = 0, 0.0, 0.0
            after = self.simulation.restart(ended, self._starts(ended), after)
            put_rows(observations, ended, self._observe(after.some(ended)))
        self._reading = after
        return observations, (self.reward_scale * outcome.reward).astype(np.float32), dones, infos

    def state(self) -> dict[str, Any]:
        """All that the rest of the episodes and later ones depend on, in plain values and arrays."""
        return {
            "simulation": self.simulation.state(),
            "reading": self._reading.state(),
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
            ValueError: If a step from it would not end, or leave the worlds.
        """
        self.simulation.restore(state["simulation"])
        self._reading = Reading.from_state(state["reading"])
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

    def _starts(self, robots: np.ndarray) -> Start:
        """New starts of the robots with these indices, one row each."""
        draws = StreamDraws(self._keys[robots], self._draws[robots])
        start = self.task.begin(self.scene.setup, draws)
        self._draws[robots] = draws.counts
        return start

    def _report(self, robot: int, outcome: Outcome, after: Reading) -> dict[str, Any]:
        """The `infos` of a robot whose episode ended, but for its observation."""
        ending = outcome.ending(robot, timed_out=True)
        assert ending is not None
        info = info_of(after, robot, float(self._distances[robot]), ending)
        info["pose"] = info["pose"].copy()
        info["TimeLimit.truncated"] = ending.name == TIME_LIMIT
        info["episode"] = {"r": float(self._returns[robot]), "l": int(self._lengths[robot]), "t": 0.0}
        return info
