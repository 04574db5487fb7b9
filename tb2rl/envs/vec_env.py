"""Many environments as one Stable-Baselines3 `VecEnv`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from tb2rl.envs.control_loop import FinishedEpisodes
from tb2rl.envs.encodings import rows
from tb2rl.envs.scene import Scene
from tb2rl.envs.seeded_loop import SeededLoop


class TurtleBot2VecEnv(VecEnv):
    """A control loop for Stable-Baselines3.

    Infos are empty except at the end of an episode, where they hold those of `TurtleBot2Env` and what
    Stable-Baselines3 expects: `terminal_observation`, `TimeLimit.truncated` and `episode`.

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        num_envs: Number of environments.
        reward_scale: Factor on the rewards that `step` returns; `episode` holds the unscaled return.
        simulation: The simulator, see `find_simulator`.
    """

    def __init__(self, scene: Scene, num_envs: int, reward_scale: float = 1.0, simulation: Any = "kinematic") -> None:
        self.loop = SeededLoop.open(scene, simulation, num_envs)
        self.render_mode = None
        self.reward_scale = reward_scale
        super().__init__(num_envs, scene.observation_space, scene.action_space)
        self._no_infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self.loop.seed(seed)
        return [seed] * self.num_envs

    def reset(self) -> VecEnvObs:
        return self.loop.reset_all()

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = np.asarray(actions)

    def step_wait(self) -> VecEnvStepReturn:
        transition = self.loop.step_and_reset(self._actions)
        infos, finished = self._no_infos, transition.finished
        if finished is not None:
            infos = infos.copy()
            for i, info in zip(finished.indices.tolist(), _infos(finished, transition.truncated), strict=True):
                infos[i] = info
        rewards = (self.reward_scale * transition.reward).astype(np.float32)
        return transition.observations, rewards, transition.terminated | transition.truncated, infos

    def state(self) -> dict[str, Any]:
        """See `SeededLoop.state`."""
        return self.loop.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        """See `SeededLoop.restore`."""
        self.loop.restore(state)

    def close(self) -> None:
        self.loop.close()

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        raise NotImplementedError("the environments share their attributes; make another TurtleBot2VecEnv")

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        raise NotImplementedError(f"the environments have no methods of their own, such as {method_name}")

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        reports_episodes = wrapper_class.__name__ == "Monitor"  # evaluate_policy looks for one
        return [reports_episodes for _ in self._get_indices(indices)]


def _infos(finished: FinishedEpisodes, truncated: np.ndarray) -> list[dict[str, Any]]:
    """The info of each finished episode, spelt out, because hundreds of thousands finish in a step."""
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
            "TimeLimit.truncated": timed_out,
            "episode": {"r": total, "l": length, "t": 0.0},
        }
        for pose, timed_out, observation, distance, nearest, bumped, success, ended, failed, total, length in zip(
            infos["pose"], truncated[finished.indices].tolist(), last, *columns, strict=True
        )
    ]
