"""The latest commands of each environment: with a latency, part of what makes the state Markovian."""

from __future__ import annotations

import numpy as np

from tb2rl.envs.episode_state import EpisodeState
from tb2rl.simulation import RobotState


class CommandHistory(EpisodeState):
    """The latest commands, before their latency.

    Args:
        length: Number of commands.
        delayed: Whether commands take effect later. If not, the command that took effect is remembered instead,
            because a robot may have limits of its own.
    """

    field = "command_history"

    def __init__(self, length: int, delayed: bool) -> None:
        super().__init__()
        self._length, self._delayed = length, delayed

    def blank(self, num_envs: int) -> dict[str, np.ndarray]:
        return {"commands": np.zeros((num_envs, self._length, 2))}  # the newest first

    def reset(self, robot_state: RobotState) -> None:
        """Start episodes; a robot that already drives, because it gets another goal on the way, keeps its command."""
        self._rows = self.blank(len(robot_state.command))
        self._rows["commands"][:] = robot_state.command[:, None]

    def push(self, commands: np.ndarray) -> None:
        """Remember the commands of a control step, shape (num_envs, 2)."""
        self._rows["commands"] = np.concatenate([commands[:, None], self._rows["commands"][:, :-1]], axis=1)

    def update(self, robot_state: RobotState) -> None:
        if not self._delayed:
            self._rows["commands"][:, :1] = robot_state.command[:, None]

    def last(self, count: int) -> np.ndarray:
        """V [m/s] and w [rad/s], the newest first, shape (num_envs, count, 2); 0 before the first."""
        return self._rows["commands"][:, :count]
