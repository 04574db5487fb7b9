"""The outcome of a control step: rewards and endings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tb2rl.simulation import RobotState

TIME_LIMIT = "time limit"  # ending of an episode that reached `episode_steps`
COLLISION, OBSTACLE_COLLISION = "collision", "collision with a dynamic obstacle"


def collision_endings(collided: np.ndarray, after: RobotState) -> dict[str, np.ndarray]:
    """Endings for `Outcome.failed`, by obstacle, of robots that `collided`, bool, shape (num_envs,)."""
    if after.nearest_is_dynamic is None:
        return {COLLISION: collided}
    return {COLLISION: collided & ~after.nearest_is_dynamic, OBSTACLE_COLLISION: collided & after.nearest_is_dynamic}


class Ending(NamedTuple):
    """The reason for which an episode ended."""

    name: str
    failed: bool
    success: bool


@dataclass(frozen=True)
class Outcome:
    """Rewards, and the episodes that end.

    If several endings apply, the first one counts, and failures count before successes.

    Attributes:
        reward: Shape (num_envs,).
        failed: Endings that are failures, by name: masks, bool, shape (num_envs,).
        succeeded: Endings that are successes, likewise; None: a task without a goal, where reaching the time limit is a
            success.
    """

    reward: np.ndarray
    failed: Mapping[str, np.ndarray] = field(default_factory=dict)
    succeeded: Mapping[str, np.ndarray] | None = None

    @property
    def terminated(self) -> np.ndarray:
        """Whether each episode ends, bool, shape (num_envs,)."""
        masks = [*self.failed.values(), *(self.succeeded or {}).values()]
        if len(masks) == 1:  # common, and the general way takes longer than the step of a robot
            return masks[0]
        return np.logical_or.reduce(masks) if masks else np.zeros(len(self.reward), dtype=bool)

    def ending(self, index: int, timed_out: bool) -> Ending | None:
        """Ending of one environment's episode, None if it goes on; `timed_out` if it has reached its time limit."""
        return self.endings(np.array([index]))[0] if timed_out or self.terminated[index] else None

    def endings(self, indices: np.ndarray) -> list[Ending]:
        """Endings of the episodes of some environments, shape (n,); the time limit where no other ending applies."""
        endings = [Ending(TIME_LIMIT, failed=False, success=self.succeeded is None)] * len(indices)
        for masks, failed in ((self.succeeded or {}, False), (self.failed, True)):
            for name, mask in reversed(list(masks.items())):  # the first overwrites the others
                ending = Ending(name, failed, success=not failed)
                for i in mask[indices].nonzero()[0].tolist():
                    endings[i] = ending
        return endings
