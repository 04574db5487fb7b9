"""Many robots as one Stable-Baselines3 `VecEnv`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from tb2rl.envs.batch import ControlLoop, FinishedEpisodes
from tb2rl.envs.encodings import rows
from tb2rl.envs.scene import Scene


class BatchVecEnv(VecEnv):
    """A `ControlLoop` for Stable-Baselines3.

    Robots begin anew by themselves; `infos` are empty but for an episode's end, where they hold what `TurtleBot2Env`
    reports and what Stable-Baselines3 expects: `terminal_observation`, `TimeLimit.truncated` and `episode`.

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        num_envs: How many.
        reward_scale: Of the rewards that `step` returns; `episode` holds the unscaled return.
        simulation: "kinematic" or "bullet", see `ControlLoop`.
    """

    def __init__(self, scene: Scene, num_envs: int, reward_scale: float = 1.0, simulation: str = "kinematic") -> None:
        self.batch = ControlLoop(scene, num_envs, simulation)
        self.render_mode = None
        self.reward_scale = reward_scale
        super().__init__(num_envs, scene.observation_space, scene.action_space)
        self._nothing: list[dict[str, Any]] = [{} for _ in range(num_envs)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self.batch.seed(seed)
        return [seed] * self.num_envs

    def reset(self) -> VecEnvObs:
        return self.batch.reset()

    def step_async(self, actions: np.ndarray) -> None:
        self._chosen = np.asarray(actions)

    def step_wait(self) -> VecEnvStepReturn:
        step = self.batch.step(self._chosen)
        infos = self._nothing
        if step.finished is not None:
            infos = infos.copy()
            for robot, info in zip(
                step.finished.indices.tolist(), _reports(step.finished, step.truncated), strict=True
            ):
                infos[robot] = info
        rewards = (self.reward_scale * step.reward).astype(np.float32)
        return step.observations, rewards, step.terminated | step.truncated, infos

    def state(self) -> dict[str, Any]:
        """See `ControlLoop.state`."""
        return self.batch.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        """See `ControlLoop.restore`."""
        self.batch.restore(state)

    def close(self) -> None:
        self.batch.close()

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


def _reports(finished: FinishedEpisodes, truncated: np.ndarray) -> list[dict[str, Any]]:
    """The info of each robot whose episode ended, spelt out: a batch of thousands ends a hundred a step."""
    infos, observations = finished.infos, finished.observations
    names = "distance", "min_range", "bumped", "is_success", "ended", "failed"
    columns = *(infos[name].tolist() for name in names), finished.returns.tolist(), finished.lengths.tolist()
    last = observations
    if isinstance(observations, dict):
        last = [rows(observations, i) for i in range(len(finished.indices))]
    return [
        {
            "pose": pose,
            "distance": distance,
            "min_range": nearest,
            "bumped": bumped,
            "is_success": success,
            "ended": ended,
            "failed": failed,
            "terminal_observation": observation,
            "TimeLimit.truncated": late,
            "episode": {"r": total, "l": length, "t": 0.0},
        }
        for pose, late, observation, distance, nearest, bumped, success, ended, failed, total, length in zip(
            infos["pose"], truncated[finished.indices].tolist(), last, *columns, strict=True
        )
    ]
