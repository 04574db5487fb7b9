"""A Stable-Baselines3 `VecEnv` of many environments in one control loop."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from tb2rl.envs.control_loop import FinishedEpisodes, SeededLoop
from tb2rl.envs.encodings import take_rows
from tb2rl.envs.scene import Scene


class TurtleBot2VecEnv(VecEnv):
    """Many environments in one control loop.

    The info of an environment is empty except at the end of an episode. Then it has the keys of `TurtleBot2Env` and
    those of Stable-Baselines3: `terminal_observation`, `TimeLimit.truncated` and `episode`.

    Args:
        scene: The task, the robot, the worlds and the observation.
        num_envs: Number of environments.
        reward_scale: Factor on the rewards that `step` returns; `episode` holds the unscaled return.
        simulation: The simulator, see `find_simulator`.
    """

    def __init__(self, scene: Scene, num_envs: int, reward_scale: float = 1.0, simulation: Any = "kinematic") -> None:
        # With `processes=1` PyBullet spawns a noise generator for a single environment, too, as for several.
        self.loop = SeededLoop.open(scene, simulation, num_envs, processes=1 if num_envs == 1 else None)
        self.reward_scale, self.render_mode = reward_scale, None
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
        transition = self.loop.step(self._actions)
        infos, finished = self._no_infos, transition.finished
        if finished is not None:
            self.loop.reset_some(finished.indices, transition.observations)
            infos = infos.copy()
            for i, info in zip(finished.indices.tolist(), _infos(finished, transition.truncated), strict=True):
                infos[i] = info
        rewards = (self.reward_scale * transition.reward).astype(np.float32)
        return transition.observations, rewards, transition.terminated | transition.truncated, infos

    def close(self) -> None:
        self.loop.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("the environments have the same attributes; make another TurtleBot2VecEnv instead")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        raise NotImplementedError(f"the environments share one control loop, so none has a method {method_name}")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: Any = None) -> list[bool]:
        return [wrapper_class.__name__ == "Monitor" for _ in self._get_indices(indices)]  # infos have its `episode`


def _infos(finished: FinishedEpisodes, truncated: np.ndarray) -> list[dict[str, Any]]:
    """The info of each finished episode; dictionary literals are fast, and many episodes can finish in a step."""
    infos, observations = finished.infos, finished.observations
    names = "distance", "min_range", "bumped", "is_success", "ended", "failed"
    columns = *(infos[name].tolist() for name in names), finished.returns.tolist(), finished.lengths.tolist()
    last_observations = observations
    if isinstance(observations, dict):
        last_observations = [take_rows(observations, i) for i in range(len(finished.indices))]
    return [
        {
            "pose": pose,
            "distance": distance,
            "min_range": min_range,
            "bumped": bumped,
            "is_success": success,
            "ended": ended,
            "failed": failed,
            "terminal_observation": observation,
            "TimeLimit.truncated": timed_out,
            "episode": {"r": total, "l": length, "t": 0.0},
        }
        for pose, timed_out, observation, distance, min_range, bumped, success, ended, failed, total, length in zip(
            infos["pose"], truncated[finished.indices].tolist(), last_observations, *columns, strict=True
        )
    ]
