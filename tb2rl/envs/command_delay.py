"""What robots are told: they obey it as late as they are, and who told it knows it at once."""

from __future__ import annotations

import numpy as np

from tb2rl.envs.episode_state import EpisodeState
from tb2rl.simulation import RobotState


class CommandDelay(EpisodeState):
    """Hands commands to some robots, to each as many control steps later as it is late, and remembers them.

    Args:
        latency: The latest that any robot can be [control steps].
        kept: How many of the latest commands sensors ask for.
    """

    field = "command_history"

    def __init__(self, latency: int, kept: int = 0) -> None:
        super().__init__()
        self._latest = latency
        self._kept = max(kept, latency + 1 if latency else 0)

    @property
    def is_used(self) -> bool:
        """Whether there is anything to remember: a robot that is late, or a sensor that asks."""
        return self._kept > 0

    def blank(self, num_envs: int) -> dict[str, np.ndarray]:
        return {"told": np.zeros((num_envs, self._kept, 2))}  # the newest first

    def begin(self, robot_state: RobotState) -> None:
        """See `EpisodeState.begin`. A robot that drives already, when it gets another goal on the way, was told to
        before.
        """
        self._rows = self.blank(len(robot_state.command))
        self._rows["told"][:] = robot_state.command[:, None]

    def go_on(self, robot_state: RobotState) -> None:
        """Note what a robot made of it that is not late, but may have a limit of its own."""
        if not self._latest:
            self._rows["told"][:, :1] = robot_state.command[:, None]

    def push(self, commands: np.ndarray, late: np.ndarray) -> np.ndarray:
        """What the robots obey now.

        Args:
            commands: What they are told, v [m/s] and w [rad/s], shape (num_envs, 2).
            late: By how many control steps each robot is late, shape (num_envs,).
        """
        if not self._kept:
            return commands
        told = self._rows["told"] = np.concatenate([commands[:, None], self._rows["told"][:, :-1]], axis=1)
        return told[np.arange(len(told)), late.astype(int)] if self._latest else commands

    def last(self, count: int) -> np.ndarray:
        """The last so many commands of each robot, the newest first, shape (num_envs, count, 2); 0 before the first."""
        return self._rows["told"][:, :count]
