"""A Gymnasium `VectorEnv` of many environments in one control loop."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.values import Count, checked
from tb2rl.envs.control_loop import FinishedEpisodes, SeededLoop
from tb2rl.envs.encodings import take_rows
from tb2rl.envs.scene import Scene


class TurtleBot2VectorEnv(VectorEnv[Any, Any, Any]):
    """Many environments in one control loop.

    `infos` has the keys of `TurtleBot2Env`; each value is an array with one row per environment. `autoreset_mode`
    selects when the next episode starts after the end of one, as in Gymnasium's `SyncVectorEnv`:

    | mode | start of the next episode |
    |---|---|
    | `SAME_STEP` | in the same step; `final_obs` and `final_info` belong to the old episode |
    | `NEXT_STEP` | in the next step, which ignores the environment's action and returns the reward 0 |
    | `DISABLED` | by `reset(options={"reset_mask": mask})` before the next step; mask: bool, shape (num_envs,) |

    Args:
        scene: The task, the robot, the worlds and the observation.
        num_envs: Number of environments.
        autoreset_mode: A mode, or its name.
        simulation: The simulator, see `find_simulator`.

    Raises:
        InputError: If `num_envs` or `autoreset_mode` is invalid.
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
        self._observations: Any = None  # the latest observations, for resets of some environments
        self.single_observation_space, self.single_action_space = scene.observation_space, scene.action_space
        self.observation_space = batch_space(scene.observation_space, num_envs)
        self.action_space = batch_space(scene.action_space, num_envs)
        self._all_true, self._all_false = np.ones(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._awaits_reset = self._all_false  # mask of the environments whose next episode has not started

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every environment, or in those of the option `reset_mask`.

        Raises:
            InputError: If the mask is invalid or combined with a seed, or there is another option.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise InputError(f"unknown option {next(iter(options))!r}; vector environments support only reset_mask")
        if mask is not None:
            return self._reset_some(mask, seed)
        if seed is not None:
            self.loop.seed(seed)
        self._awaits_reset, observations = self._all_false, self.loop.reset_all()
        return self._store(observations), self._infos()

    def _reset_some(self, mask: np.ndarray, seed: int | list[int] | None) -> tuple[Any, dict[str, Any]]:
        if not (isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (self.num_envs,) and mask.any()):
            raise InputError(f"options.reset_mask must be a bool array of shape ({self.num_envs},) with a True in it")
        if seed is not None:
            raise InputError("reset_mask cannot be combined with a seed; the environments keep their random streams")
        indices, observations = mask.nonzero()[0], deepcopy(self._observations)
        self.loop.reset_some(indices, observations)
        self._awaits_reset = self._awaits_reset & ~mask
        return self._store(observations), self._scatter(self.loop.infos(indices), indices)

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold an action in each environment for a control period.

        Raises:
            InputError: If an environment needs a reset, actions have the wrong shape, or a discrete action is invalid.
        """
        actions = np.asarray(actions)
        discrete = isinstance(self.single_action_space, Discrete)  # continuous actions are clipped instead
        invalid = discrete and not (actions.dtype.kind in "iu" and self.action_space.contains(actions))
        if actions.shape != self.action_space.shape or invalid:
            raise InputError(one_line(f"the actions {actions} are not in {self.action_space}"))
        reset_indices = self._awaits_reset.nonzero()[0]
        if len(reset_indices) and self._mode is AutoresetMode.DISABLED:
            fix = "start the next one by reset(options={'reset_mask': mask})"
            raise InputError(f"the episode of environment {reset_indices[0]} is over; {fix}")
        transition = self.loop.step(actions, inactive=self._awaits_reset if len(reset_indices) else None)
        finished = transition.finished
        if self._mode is AutoresetMode.SAME_STEP:
            reset_indices = np.empty(0, int) if finished is None else finished.indices
        else:
            self._awaits_reset = transition.terminated | transition.truncated
        if len(reset_indices):
            self.loop.reset_some(reset_indices, transition.observations)
        infos = self._infos()
        if finished is not None and self._mode is AutoresetMode.SAME_STEP:
            infos |= self._final_infos(finished)
        elif finished is not None:
            for name in ("is_success", "ended", "failed"):  # "ended" is the reason
                infos[name][finished.indices] = finished.infos[name]
        observations = self._store(transition.observations)
        return observations, transition.reward, transition.terminated, transition.truncated, infos

    def _store(self, observations: Any) -> Any:
        """Return the observations, and store them for the environments that the next `reset_mask` leaves out."""
        # With DISABLED, callers use `reset_mask`, and may change the returned arrays before that; hence the copy.
        self._observations = deepcopy(observations) if self._mode is AutoresetMode.DISABLED else observations
        return observations

    def close_extras(self, **_: Any) -> None:
        self.loop.close()

    def _infos(self) -> dict[str, Any]:
        """Infos of all environments, which `step` corrects for those whose episode has ended."""
        infos = self.loop.infos()
        return infos | {f"_{name}": self._all_true for name in infos}

    def _final_infos(self, finished: FinishedEpisodes) -> dict[str, Any]:
        """`final_obs` and `final_info`, in the form of `VectorEnv._add_info`."""
        observations = np.full(self.num_envs, None, dtype=object)
        for i, index in enumerate(finished.indices):
            observations[index] = take_rows(finished.observations, i)
        info = self._scatter(finished.infos, finished.indices)
        mask = info["_ended"]  # the same for all keys: the environments of `finished`
        return {"final_obs": observations, "_final_obs": mask, "final_info": info, "_final_info": mask}

    def _scatter(self, some_infos: Mapping[str, np.ndarray], indices: np.ndarray) -> dict[str, Any]:
        """Expand infos of the environments `indices` to all environments: 0 or None for the others, and masks."""
        mask = self._all_false.copy()
        mask[indices] = True
        infos: dict[str, Any] = {}
        for name, values in some_infos.items():
            default = None if values.dtype == object else 0
            infos[name] = np.full((self.num_envs, *values.shape[1:]), default, values.dtype)
            infos[name][indices] = values
            infos[f"_{name}"] = mask
        return infos


def find_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """The autoreset mode with a name such as "NEXT_STEP" or "NextStep".

    Raises:
        InputError: If there is no such mode.
    """
    for member in AutoresetMode:
        if mode is member or (isinstance(mode, str) and mode.replace("_", "").lower() == member.value.lower()):
            return member
    raise unknown("autoreset_mode", mode, AutoresetMode.__members__)
