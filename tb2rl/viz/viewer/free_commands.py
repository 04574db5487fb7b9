"""The user as a policy."""

from typing import Any

import numpy as np

from tb2rl.tasks import Actions

KEYS = {"W": (0.1, 0.0), "S": (-0.1, 0.0), "A": (0.0, 0.5), "D": (0.0, -0.5)}  # changes of v [m/s], w [rad/s]


class FreeCommands:
    """The user as a policy: the robot obeys `command`, and the task judges the nearest action.

    It takes the place of the task's actions, too, because few tasks have an action for every command.
    """

    def __init__(self, actions: Actions) -> None:
        self._actions, self.command = actions, np.zeros(2)

    def __getattr__(self, name: str) -> Any:  # everything but `commands` as in the actions
        return getattr(self._actions, name)

    def commands(self, actions: np.ndarray) -> np.ndarray:
        """The user's command, shape (1, 2), in place of that of the action."""
        return self.command[None]

    def predict(self, observation: Any, deterministic: bool = True) -> tuple[Any, None]:
        """The action nearest to the command."""
        return self._actions.nearest(self.command), None
