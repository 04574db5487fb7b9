"""What robots are told: they obey it as late as they are, and who told it knows it at once."""

from __future__ import annotations

import numpy as np

from tb2rl.envs.memory import Memory
from tb2rl.simulation import Reading


class Commander(Memory):
    """Hands commands to some robots, to each as many control steps later as it is late, and remembers them.

    Args:
        latency: The latest that any robot can be [control steps].
        kept: How many of the latest commands sensors ask for.
    """

    field = "told"

    def __init__(self, latency: int, kept: int = 0) -> None:
        super().__init__()
        self._latest = latency
        self._kept = max(kept, latency + 1 if latency else 0)

    @property
    def is_used(self) -> bool:
        """Whether there is anything to remember: a robot that is late, or a sensor that asks."""
        return self._kept > 0

    def blank(self, robots: int) -> dict[str, np.ndarray]:
        return {"told": np.zeros((robots, self._kept, 2))}  # the newest first

    def begin(self, reading: Reading) -> None:
        """See `Memory.begin`. A robot that drives already, when it gets another goal on the way, was told to before."""
        self._rows = self.blank(len(reading.command))
        self._rows["told"][:] = reading.command[:, None]

    def go_on(self, reading: Reading) -> None:
        """Note what a robot made of it that is not late, but may have a limit of its own."""
        if not self._latest:
            self._rows["told"][:, :1] = reading.command[:, None]

    def pass_on(self, commands: np.ndarray, late: np.ndarray) -> np.ndarray:
        """What the robots obey now.

        Args:
            commands: What they are told, v [m/s] and w [rad/s], shape (robots, 2).
            late: By how many control steps each robot is late, shape (robots,).
        """
        if not self._kept:
            return commands
        told = self._rows["told"] = np.concatenate([commands[:, None], self._rows["told"][:, :-1]], axis=1)
        return told[np.arange(len(told)), late.astype(int)] if self._latest else commands

    def last(self, count: int) -> np.ndarray:
        """The last so many commands of each robot, the newest first, shape (robots, count, 2); 0 before the first."""
        return self._rows["told"][:, :count]
