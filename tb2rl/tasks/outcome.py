"""What a task makes of one control step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tb2rl.simulation import RobotState

TIME_LIMIT = "time limit"  # the ending of an episode whose steps are used up
COLLISION, OBSTACLE_COLLISION = "collision", "collision with a dynamic obstacle"


def collision_endings(collided: np.ndarray, after: RobotState) -> dict[str, np.ndarray]:
    """Endings of robots that have crashed, for `Outcome.failed`: into a wall, or into something that moves.

    Args:
        collided: Which have, bool, shape (num_envs,).
        after: The reading that says so.
    """
    if after.nearest_is_dynamic is None:
        return {COLLISION: collided}
    return {COLLISION: collided & ~after.nearest_is_dynamic, OBSTACLE_COLLISION: collided & after.nearest_is_dynamic}


class Ending(NamedTuple):
    """Why an episode is over."""

    name: str
    failed: bool
    success: bool


@dataclass(frozen=True)
class Outcome:
    """Rewards, and which episodes end here.

    An ending says by its place whether it counts as failed or as a success. Of several, the first counts, failed ones
    before the others.

    Attributes:
        reward: Shape (num_envs,).
        failed: Endings that count as failed, by name, each with its robots, bool, shape (num_envs,).
        succeeded: Endings at the goal, likewise; None for a task without a goal, where an episode succeeds that
            reaches its time limit.
    """

    reward: np.ndarray
    failed: Mapping[str, np.ndarray] = field(default_factory=dict)
    succeeded: Mapping[str, np.ndarray] | None = None

    @property
    def terminated(self) -> np.ndarray:
        """Whether an episode ends here, bool, shape (num_envs,)."""
        masks = [*self.failed.values(), *self.succeeded.values()] if self.succeeded else list(self.failed.values())
        if len(masks) == 1:  # as in most tasks; the general way takes longer than a robot's step
            return masks[0]
        return np.logical_or.reduce(masks) if masks else np.zeros(len(self.reward), dtype=bool)

    def ending(self, robot: int, timed_out: bool) -> Ending | None:
        """Why the episode of a robot is over, None if it is not; `timed_out` says that its steps are used up."""
        for name, where in self.failed.items():
            if where[robot]:
                return Ending(name, failed=True, success=False)
        for name, where in (self.succeeded or {}).items():
            if where[robot]:
                return Ending(name, failed=False, success=True)
        return Ending(TIME_LIMIT, failed=False, success=self.succeeded is None) if timed_out else None

    def endings(self, indices: np.ndarray) -> list[Ending]:
        """Why the episodes of the robots with indices `robots` (n,) are over, by their time limit if not otherwise.

        The same as `ending` of each, for hundreds that end in one step.
        """
        endings = [Ending(TIME_LIMIT, failed=False, success=self.succeeded is None)] * len(indices)
        for masks, failed in ((self.succeeded or {}, False), (self.failed, True)):
            for name, where in reversed(list(masks.items())):  # the first one has the last word
                ending = Ending(name, failed, success=not failed)
                for i in where[indices].nonzero()[0].tolist():
                    endings[i] = ending
        return endings
