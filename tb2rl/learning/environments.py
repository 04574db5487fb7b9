"""The environments of a training, as one `VecEnv`, and their state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, unwrap_vec_normalize

from tb2rl.envs.processes import ProcessVecEnv
from tb2rl.envs.scene import Scene
from tb2rl.envs.single import TurtleBot2Env
from tb2rl.envs.vec_env import BatchVecEnv
from tb2rl.learning.trees import fill
from tb2rl.runs.config import Config
from tb2rl.simulation import check_bullet


def make_vec_env(config: Config) -> VecEnv:
    """The environments of a training: one batch of the fast twin, or PyBullet's, shared out among processes."""
    settings = config.train
    steps = settings.episode_steps
    scene = config.scene if steps is None else config.scene.changed(episode_steps=steps)
    if settings.simulation == "kinematic":
        return BatchVecEnv(scene, settings.n_envs, settings.reward_scale)
    check_bullet("a training in simulation 'bullet' (unlike 'kinematic', its fast twin)")  # before processes start
    functions: list[Callable[[], gym.Env]] = [partial(_make_env, scene, settings.reward_scale)] * settings.n_envs
    return DummyVecEnv(functions) if len(functions) == 1 else ProcessVecEnv(functions)


def state_of(env: VecEnv) -> Any:
    """The state of all environments in plain values and arrays: one tree of a batch, else a list of them.

    Where `VecNormalize` is around them, a tree with its own state beside theirs, but for its statistics, which are
    saved with the policy.
    """
    state = env.state() if hasattr(env, "state") else env.env_method("state")
    around = unwrap_vec_normalize(env)
    if around is None:
        return state
    return {"inner": state, "returns": around.returns.copy(), "observations": around.get_original_obs()}


def restore(env: VecEnv, state: Any) -> None:
    """Put the state of all environments back; they have been reset.

    Raises:
        ValueError: If it is not one of such environments.
    """
    state = fill(state_of(env), state, "environments")
    around = unwrap_vec_normalize(env)
    if around is not None:
        around.returns, around.old_obs, state = state["returns"], state["observations"], state["inner"]
        if not np.isfinite(around.returns).all():
            raise ValueError("environments.returns are not finite")
    if hasattr(env, "restore"):
        env.restore(state)
        return
    for i, one in enumerate(state):
        env.env_method("restore", one, indices=[i])


def _make_env(scene: Scene, reward_scale: float) -> gym.Env:
    return TrainingEnv(TurtleBot2Env(scene), reward_scale)


class TrainingEnv(gym.Wrapper[Any, Any, Any, Any]):
    """Reports an episode that ends as Stable-Baselines3 wants it (its `Monitor` does not resume), scales rewards.

    Args:
        env: The environment.
        reward_scale: Of the rewards that `step` returns; `episode` holds the unscaled return.
    """

    env: TurtleBot2Env

    def __init__(self, env: TurtleBot2Env, reward_scale: float = 1.0) -> None:
        super().__init__(env)
        self.reward_scale = reward_scale
        self._return, self._length = 0.0, 0

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        self._return, self._length = 0.0, 0
        return self.env.reset(**arguments)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._return += float(reward)
        self._length += 1
        if terminated or truncated:
            info["episode"] = {"r": self._return, "l": self._length, "t": 0.0}
        return observation, self.reward_scale * float(reward), terminated, truncated, info

    def state(self) -> dict[str, Any]:
        """All that the rest of the episode and later ones depend on, in plain values and arrays."""
        return {**self.env.state(), "return": self._return, "length": self._length}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state` as if nothing had happened since."""
        self.env.restore(state)
        self._return, self._length = float(state["return"]), int(state["length"])
