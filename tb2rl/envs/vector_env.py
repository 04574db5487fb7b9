"""Thousands of robots as one Gymnasium `VectorEnv`."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.values import Count, checked
from tb2rl.envs.batch import ControlLoop, FinishedEpisodes, Step
from tb2rl.envs.encodings import rows
from tb2rl.envs.scene import Scene


class BatchVectorEnv(VectorEnv[Any, Any, Any]):
    """A `ControlLoop` for Gymnasium.

    Keys of `infos` are those of `TurtleBot2Env`, each an array with a row for each robot. When a robot whose episode
    ended begins anew says `autoreset_mode`, as in Gymnasium's own `SyncVectorEnv`:

    | mode | a new episode begins |
    |---|---|
    | `SAME_STEP` | in the same step; `final_obs` and `final_info` hold where the last one ended |
    | `NEXT_STEP` | in the next step, which ignores the robot's action; its reward is 0 |
    | `DISABLED` | by `reset(options={"reset_mask": mask})`, bool, shape (num_envs,); a step needs it |

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        num_envs: How many robots.
        autoreset_mode: A mode, or its name.

    Raises:
        InputError: If that is no number of robots, or no mode.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(
        self, scene: Scene, num_envs: int = 1, autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP
    ) -> None:
        self._mode = find_autoreset_mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        self.batch, self.num_envs = ControlLoop(scene, checked(Count, num_envs, "num_envs")), num_envs
        self._begun, self._observations = False, None
        self.single_observation_space, self.single_action_space = scene.observation_space, scene.action_space
        self.observation_space = batch_space(scene.observation_space, num_envs)
        self.action_space = batch_space(scene.action_space, num_envs)
        self._all, self._none = np.ones(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._no_ending = np.full(num_envs, "", dtype=object)
        self._over = self._none  # robots whose episodes ended, and which begin anew later

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode of every robot, or of those alone that the option `reset_mask` says, which takes no seed.

        Raises:
            InputError: For another option, or a mask that is none.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise InputError(
                f"robots of a batch begin where their task says: there is no option {next(iter(options))!r}"
            )
        if mask is not None:
            return self._reset_some(mask, seed)
        if seed is not None:
            self.batch.seed(seed)
        self._begun, self._over, observations = True, self._none, self.batch.reset()
        return self._kept(observations), self._infos()

    def _reset_some(self, mask: np.ndarray, seed: int | list[int] | None) -> tuple[Any, dict[str, Any]]:
        if not (isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == self._none.shape and mask.any()):
            raise InputError(f"options.reset_mask must be a bool array of shape ({self.num_envs},) with a True in it")
        if seed is not None:
            raise InputError("reset_mask takes no seed: the random streams of the robots go on")
        if not self._begun:
            raise InputError("reset_mask needs a reset of all robots first")
        indices, observations = mask.nonzero()[0], deepcopy(self._observations)
        self.batch.reset_at(indices, observations)
        self._over = self._over & ~mask
        infos = {name: column[indices] for name, column in self._infos().items() if not name.startswith("_")}
        return self._kept(observations), self._of_some(infos, indices)

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
        step, infos = self._same_step(actions) if self._mode is AutoresetMode.SAME_STEP else self._later(actions)
        return self._kept(step.observations), step.reward, step.terminated, step.truncated, infos

    def _same_step(self, actions: np.ndarray) -> tuple[Step, dict[str, Any]]:
        step = self.batch.step(actions)
        infos = self._infos()
        if step.finished is not None:
            infos |= self._final_infos(step.finished)
        return step, infos

    def _later(self, actions: np.ndarray) -> tuple[Step, dict[str, Any]]:
        """A step after which robots wait where their episodes ended."""
        over = self._over.nonzero()[0]
        if len(over) and self._mode is AutoresetMode.DISABLED:
            raise InputError(
                f"the episode of robot {over[0]} is over; reset(options={{'reset_mask': mask}}) begins another one"
            )
        step = self.batch.advance(actions, self._over if len(over) else None)
        if len(over):
            self.batch.reset_at(over, step.observations)
        self._over, infos = step.terminated | step.truncated, self._infos()
        if step.finished is not None:
            for name in ("is_success", "ended", "failed"):
                infos[name] = infos[name].copy()
                infos[name][step.finished.indices] = step.finished.infos[name]
        return step, infos

    def _kept(self, observations: Any) -> Any:
        """Observations to return, which the next reset of some robots returns for the others."""
        self._observations = deepcopy(observations) if self._mode is AutoresetMode.DISABLED else observations
        return observations

    def close_extras(self, **_: Any) -> None:
        self.batch.close()

    def _infos(self) -> dict[str, Any]:
        """Those of robots whose episodes go on, or have just begun; see `tb2rl.envs.single.info_of`."""
        robot_state = self.batch.robot_state
        infos: dict[str, Any] = {
            "pose": robot_state.pose.copy(),
            "distance": self.batch.distances.copy(),
            "min_range": robot_state.nearest,
            "bumped": robot_state.bumped.copy(),
            "is_success": self._none,
            "ended": self._no_ending,
            "failed": self._none,
        }
        return infos | {f"_{name}": self._all for name in infos}

    def _final_infos(self, finished: FinishedEpisodes) -> dict[str, Any]:
        """`final_obs` and `final_info`, in the form of `VectorEnv._add_info`, for all of them at once."""
        ended = self._none.copy()
        ended[finished.indices] = True
        observations = np.full(self.num_envs, None, dtype=object)
        for i, robot in enumerate(finished.indices):
            observations[robot] = rows(finished.observations, i)
        info = self._of_some(finished.infos, finished.indices)
        return {"final_obs": observations, "_final_obs": ended, "final_info": info, "_final_info": ended}

    def _of_some(self, columns: Mapping[str, np.ndarray], indices: np.ndarray) -> dict[str, Any]:
        """Infos of some robots, a row for each, as infos of all: 0 or None for the others, and masks."""
        mask = self._none.copy()
        mask[indices] = True
        infos: dict[str, Any] = {}
        for name, column in columns.items():
            nothing = None if column.dtype == object else 0
            infos[name] = np.full((self.num_envs, *column.shape[1:]), nothing, column.dtype)
            infos[name][indices] = column
            infos[f"_{name}"] = mask
        return infos

    def _exist(self, actions: np.ndarray) -> bool:
        """Whether all of the actions do, where they are named commands; velocities are cut to what there is."""
        space = self.single_action_space
        if not isinstance(space, Discrete):
            return True
        return actions.dtype.kind in "iu" and actions.min() >= 0 and actions.max() < space.n


def find_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """The mode of a name, such as "NEXT_STEP" or "NextStep".

    Raises:
        InputError: If there is no such mode.
    """
    for known in AutoresetMode:
        if mode is known or (isinstance(mode, str) and mode.replace("_", "").lower() == known.value.lower()):
            return known
    raise unknown("autoreset_mode", mode, AutoresetMode.__members__)
