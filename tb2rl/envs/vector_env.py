"""Thousands of robots as one Gymnasium `VectorEnv`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from tb2rl.envs.batch import Batch, Finals
from tb2rl.envs.encodings import rows
from tb2rl.envs.scene import Scene
from tb2rl.errors import InputError, one_line
from tb2rl.values import Count, checked


class BatchVectorEnv(VectorEnv[Any, Any, Any]):
    """A `Batch` for Gymnasium.

    A robot whose episode ends begins anew in the same step (`AutoresetMode.SAME_STEP`): `final_obs` and `final_info`
    hold where the episode ended, as in Gymnasium's own `SyncVectorEnv`. Keys of `infos` are those of `TurtleBot2Env`,
    each an array with a row for each robot.

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        num_envs: How many robots.

    Raises:
        InputError: If that is no number of robots.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(self, scene: Scene, num_envs: int = 1) -> None:
        self.batch, self.num_envs = Batch(scene, checked(Count, num_envs, "num_envs")), num_envs
        self._begun = False
        self.single_observation_space, self.single_action_space = scene.observation_space, scene.action_space
        self.observation_space = batch_space(scene.observation_space, num_envs)
        self.action_space = batch_space(scene.action_space, num_envs)
        self._all, self._none = np.ones(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._no_ending = np.full(num_envs, "", dtype=object)

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode of every robot.

        Raises:
            InputError: For options: a batch has none.
        """
        if options:
            raise InputError(
                f"robots of a batch begin where their task says: there is no option {next(iter(options))!r}"
            )
        if seed is not None:
            self.batch.seed(seed)
        self._begun, observations = True, self.batch.reset()
        return observations, self._infos()

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold an action of each robot for a control period.

        Raises:
            InputError: If nothing was reset, or an action does not exist, or there are more or fewer than robots.
        """
        if not self._begun:
            raise InputError("step needs a reset first")
        actions = np.asarray(actions)
        if actions.shape != self.action_space.shape or not self._exist(actions):
            raise InputError(one_line(f"the actions {actions} are not of {self.action_space}"))
        step = self.batch.step(actions)
        infos = self._infos()
        if step.finals is not None:
            infos |= self._final_infos(step.finals)
        return step.observations, step.reward, step.terminated, step.truncated, infos

    def close_extras(self, **_: Any) -> None:
        self.batch.close()

    def _infos(self) -> dict[str, Any]:
        """Those of robots whose episodes go on, or have just begun; see `tb2rl.envs.single.info_of`."""
        reading = self.batch.reading
        infos: dict[str, Any] = {
            "pose": reading.pose.copy(),
            "distance": self.batch.distances.copy(),
            "min_range": reading.nearest,
            "bumped": reading.bumped,
            "is_success": self._none,
            "ended": self._no_ending,
            "failed": self._none,
        }
        return infos | {f"_{name}": self._all for name in infos}

    def _final_infos(self, finals: Finals) -> dict[str, Any]:
        """`final_obs` and `final_info`, in the form of `VectorEnv._add_info`, for all of them at once."""
        ended = self._none.copy()
        ended[finals.robots] = True
        observations = np.full(self.num_envs, None, dtype=object)
        for i, robot in enumerate(finals.robots):
            observations[robot] = rows(finals.observations, i)
        info: dict[str, Any] = {}
        for name, column in finals.infos.items():
            nothing = None if column.dtype == object else 0
            info[name] = np.full((self.num_envs, *column.shape[1:]), nothing, column.dtype)
            info[name][finals.robots] = column
            info[f"_{name}"] = ended
        return {"final_obs": observations, "_final_obs": ended, "final_info": info, "_final_info": ended}

    def _exist(self, actions: np.ndarray) -> bool:
        """Whether all of the actions do, where they are named commands; velocities are cut to what there is."""
        space = self.single_action_space
        if not isinstance(space, Discrete):
            return True
        return actions.dtype.kind in "iu" and actions.min() >= 0 and actions.max() < space.n
