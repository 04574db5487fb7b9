"""Many environments as one Gymnasium `VectorEnv`."""

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
from tb2rl.envs.control_loop import FinishedEpisodes, Transition
from tb2rl.envs.encodings import rows
from tb2rl.envs.scene import Scene
from tb2rl.envs.seeded_loop import SeededLoop


class TurtleBot2VectorEnv(VectorEnv[Any, Any, Any]):
    """A control loop for Gymnasium.

    Keys of `infos` are those of `TurtleBot2Env`, each an array with a row for each environment. `autoreset_mode` says
    when an environment whose episode ended starts the next one, as in Gymnasium's own `SyncVectorEnv`:

    | mode | the next episode starts |
    |---|---|
    | `SAME_STEP` | in the same step; `final_obs` and `final_info` hold the end of the last one |
    | `NEXT_STEP` | in the next step, which ignores the environment's action; its reward is 0 |
    | `DISABLED` | by `reset(options={"reset_mask": mask})`, bool, shape (num_envs,), which is needed before a step |

    Args:
        scene: The task, the robot and the worlds, and how the task is observed.
        num_envs: Number of environments.
        autoreset_mode: A mode, or its name.
        simulation: The simulator, see `find_simulator`.

    Raises:
        InputError: If that is not a number of environments, or not a mode.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(
        self,
        scene: Scene,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        simulation: Any = "kinematic",
    ) -> None:
        self._mode = find_autoreset_mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        self.num_envs = checked(Count, num_envs, "num_envs")
        self.loop = SeededLoop.open(scene, simulation, num_envs)
        self._started, self._observations = False, None
        self.single_observation_space, self.single_action_space = scene.observation_space, scene.action_space
        self.observation_space = batch_space(scene.observation_space, num_envs)
        self.action_space = batch_space(scene.action_space, num_envs)
        self._all, self._none = np.ones(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._over = self._none  # environments whose episode ended, and which start the next one later

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every environment, or in those of the option `reset_mask`, which takes no seed.

        Raises:
            InputError: For another option, or a wrong mask.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise InputError(f"environments start where their task says: there is no option {next(iter(options))!r}")
        if mask is not None:
            return self._reset_some(mask, seed)
        if seed is not None:
            self.loop.seed(seed)
        self._started, self._over, observations = True, self._none, self.loop.reset_all()
        return self._kept(observations), self._infos()

    def _reset_some(self, mask: np.ndarray, seed: int | list[int] | None) -> tuple[Any, dict[str, Any]]:
        if not (isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == self._none.shape and mask.any()):
            raise InputError(f"options.reset_mask must be a bool array of shape ({self.num_envs},) with a True in it")
        if seed is not None:
            raise InputError("reset_mask takes no seed: the random streams of the environments go on")
        if not self._started:
            raise InputError("reset_mask needs a reset of all environments first")
        indices, observations = mask.nonzero()[0], deepcopy(self._observations)
        self.loop.reset_some(indices, observations)
        self._over = self._over & ~mask
        infos = {name: column[indices] for name, column in self.loop.infos().items()}
        return self._kept(observations), self._of_some(infos, indices)

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold an action in each environment for a control period.

        Raises:
            InputError: If nothing was reset, or the actions are not of the action space.
        """
        if not self._started:
            raise InputError("step needs a reset first")
        actions = np.asarray(actions)
        if actions.shape != self.action_space.shape or not self._exist(actions):
            raise InputError(one_line(f"the actions {actions} are not of {self.action_space}"))
        transition, infos = self._same_step(actions) if self._mode is AutoresetMode.SAME_STEP else self._later(actions)
        ends = transition.terminated, transition.truncated
        return self._kept(transition.observations), transition.reward, *ends, infos

    def _same_step(self, actions: np.ndarray) -> tuple[Transition, dict[str, Any]]:
        transition = self.loop.step_and_reset(actions)
        infos = self._infos()
        if transition.finished is not None:
            infos |= self._final_infos(transition.finished)
        return transition, infos

    def _later(self, actions: np.ndarray) -> tuple[Transition, dict[str, Any]]:
        """A step after which finished environments wait."""
        over = self._over.nonzero()[0]
        if len(over) and self._mode is AutoresetMode.DISABLED:
            raise InputError(
                f"the episode of environment {over[0]} is over; reset(options={{'reset_mask': mask}}) starts the next"
            )
        transition = self.loop.step(actions, self._over if len(over) else None)
        if len(over):
            self.loop.reset_some(over, transition.observations)
        self._over, infos = transition.terminated | transition.truncated, self._infos()
        if transition.finished is not None:
            for name in ("is_success", "ended", "failed"):
                infos[name] = infos[name].copy()
                infos[name][transition.finished.indices] = transition.finished.infos[name]
        return transition, infos

    def _kept(self, observations: Any) -> Any:
        """Observations to return, which a reset of some environments returns again for the others."""
        self._observations = deepcopy(observations) if self._mode is AutoresetMode.DISABLED else observations
        return observations

    def close_extras(self, **_: Any) -> None:
        self.loop.close()

    def _infos(self) -> dict[str, Any]:
        """Those of environments whose episode goes on, or has just started."""
        infos = self.loop.infos()
        return infos | {f"_{name}": self._all for name in infos}

    def _final_infos(self, finished: FinishedEpisodes) -> dict[str, Any]:
        """`final_obs` and `final_info`, in the form of `VectorEnv._add_info`."""
        ended = self._none.copy()
        ended[finished.indices] = True
        observations = np.full(self.num_envs, None, dtype=object)
        for i, index in enumerate(finished.indices):
            observations[index] = rows(finished.observations, i)
        info = self._of_some(finished.infos, finished.indices)
        return {"final_obs": observations, "_final_obs": ended, "final_info": info, "_final_info": ended}

    def _of_some(self, columns: Mapping[str, np.ndarray], indices: np.ndarray) -> dict[str, Any]:
        """Infos of some environments, a row for each, as infos of all: 0 or None for the others, and masks."""
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
        """Whether named commands are among the actions; velocities are clipped instead."""
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
