"""Whether a policy fits a task: the observations and the actions that it knows."""

from __future__ import annotations

from typing import Any

from gymnasium import spaces

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.scene import Scene


def check_observes(policy: Any, scene: Scene) -> None:
    """Raise an `InputError` where a policy would get other observations or actions than it knows."""
    given = scene.observation_space
    known = getattr(policy, "observation_space", given)
    if known != given:
        raise InputError(f"the policy knows the observation {_short(known)}, but this task gives {_short(given)}")
    known = getattr(policy, "action_space", scene.action_space)
    if known != scene.action_space:
        raise InputError(
            f"the policy knows the actions {_short(known)}, but this task has {_short(scene.action_space)}"
        )


def _short(space: spaces.Space) -> str:
    return one_line(space, 150)
