"""Agents: what `train` and `evaluate` need to build a Stable-Baselines3 algorithm or a fixed policy."""

from __future__ import annotations

from dataclasses import dataclass

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import find_plugin

ANY_POLICY = "MlpPolicy"  # stands for CnnPolicy, MlpLstmPolicy, ... where the observations need them


@dataclass(frozen=True)
class Agent:
    """Description of an agent.

    Attributes:
        algorithm: A Stable-Baselines3 `BaseAlgorithm`, as "module:Class"; None for an agent that does not learn.
        policy: The algorithm's name of its policy; `ANY_POLICY` selects the one for the observation space. An agent
            that does not learn names a `BasePolicy`, as "module:Class".
        observation: Preferred observation mode, "discrete" or "raw".
        only: Whether it works with no other mode.
        actions: Action type that it can learn, "named" (`Commands`) or "continuous" (`Velocities`); None: whatever
            its algorithm supports.
    """

    algorithm: str | None
    policy: str = ANY_POLICY
    observation: str = "raw"
    only: bool = False
    actions: str | None = None


def find_agent(name: str) -> Agent:
    """The agent of a name, or of "module:Class", where Class is an algorithm or an `Agent`.

    Raises:
        InputError: If there is none; the message lists the known ones.
    """
    found = find_plugin("agent", name)
    if isinstance(found, Agent):
        return found
    from stable_baselines3.common.base_class import BaseAlgorithm  # only now: it imports torch

    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        raise InputError(f"agent {name!r} is neither a Stable-Baselines3 algorithm nor a tb2rl.Agent")
    return Agent(algorithm=f"{found.__module__}:{found.__name__}")
