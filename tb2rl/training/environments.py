"""The environments of a training, as one `VecEnv`, and their state."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize

from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.runs.config import Config
from tb2rl.simulation import find_simulator
from tb2rl.training.trees import fill


def make_vec_env(config: Config) -> TurtleBot2VecEnv:
    """The environments of a training: one batch of the fast twin, or of PyBullet's worlds in parallel processes."""
    settings = config.train
    steps = settings.episode_steps
    scene = config.scene if steps is None else config.scene.changed(episode_steps=steps)
    find_simulator(settings.simulation).check(f"a training in simulation {settings.simulation!r}")
    return TurtleBot2VecEnv(scene, settings.n_envs, settings.reward_scale, settings.simulation)


def state_of(env: VecEnv) -> Any:
    """The state of all environments in plain values and arrays.

    Where `VecNormalize` is around them, a tree with its own state beside theirs, but for its statistics, which are
    saved with the policy.
    """
    batch: Any = env.unwrapped  # a `TurtleBot2VecEnv`
    state = batch.state()
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
    batch: Any = env.unwrapped
    batch.restore(state)
