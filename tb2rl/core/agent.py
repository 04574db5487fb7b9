"""Descriptions of agents, from which `train` and `evaluate` make a Stable-Baselines3 algorithm or a fixed policy."""

from dataclasses import dataclass
from typing import Any

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import find_plugin, import_object

ANY_POLICY = "MlpPolicy"  # placeholder for the policy that the observations need, such as CnnPolicy


@dataclass(frozen=True)
class Agent:
    """Description of an agent.

    Attributes:
        algorithm: A Stable-Baselines3 `BaseAlgorithm`, as "module:Class"; None for an agent that does not learn.
        policy: Name of the algorithm's policy; `ANY_POLICY` selects the policy for the observation space. For an agent
            that does not learn, a `BasePolicy`, as "module:Class".
        observation: Default observation mode, "discrete" or "raw".
        fixed_obs_mode: Whether the agent supports only this observation mode.
        actions: Type of actions that the agent can learn, "discrete" (`Commands`) or "continuous" (`Velocities`); None:
            all types that the algorithm supports.
    """

    algorithm: str | None
    policy: str = ANY_POLICY
    observation: str = "raw"
    fixed_obs_mode: bool = False
    actions: str | None = None

    def load(self) -> Any:
        """Import the class of the algorithm, or that of the policy if the agent does not learn."""
        return import_object(self.algorithm or self.policy)


def find_agent(name: str) -> Agent:
    """Find an agent by name, or by reference to an `Agent` or an algorithm class.

    Raises:
        InputError: If the agent does not exist; the message lists the known agents.
    """
    plugin = find_plugin("agent", name)
    if isinstance(plugin, Agent):
        return plugin
    from stable_baselines3.common.base_class import BaseAlgorithm  # here, because it imports torch

    if not (isinstance(plugin, type) and issubclass(plugin, BaseAlgorithm)):
        raise InputError(f"agent {name!r} is neither a Stable-Baselines3 algorithm nor a tb2rl.Agent")
    return Agent(algorithm=f"{plugin.__module__}:{plugin.__name__}")
