"""What a policy computes for an observation: action values, probabilities, the critic's value."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.distributions import CategoricalDistribution
from stable_baselines3.common.policies import ActorCriticPolicy, ContinuousCritic

from tb2rl.tasks import Actions

COMMAND = "command"  # meaning of scores that are a speed and a turn rate
ACTION_VALUES = "expected sum of the rewards to come after each action, later ones discounted; bars show differences"


@dataclass(frozen=True)
class PolicyValues:
    """Numbers of a policy for one observation."""

    scores: dict[str, float]  # by action, or by component of the command
    meaning: str  # of the scores, such as "probability of each action"
    limits: dict[str, tuple[float, float]]  # least and largest value of each score, for bars
    value: float  # expected return

    def is_chosen(self, name: str) -> bool:
        """Whether a score is that of the chosen action."""
        return self.meaning != COMMAND and self.scores[name] == max(self.scores.values())


def policy_values(policy: Any, observation: Any, actions: Actions) -> PolicyValues | None:
    """The numbers from which a policy chooses its action.

    Args:
        policy: A Stable-Baselines3 algorithm or policy, or any other object.
        observation: One observation, without a leading axis.
        actions: The task's actions, whose names label the scores.

    Returns:
        None if the policy computes no such numbers, or needs more than the observation, as recurrent policies do.
    """
    policy = getattr(policy, "policy", policy)
    if hasattr(policy, "states") and hasattr(policy, "visits"):  # a Q-table
        row = policy.q.detach().numpy()[policy.states(np.asarray(observation))][0]
        return _action_values(row, actions)
    if not hasattr(policy, "obs_to_tensor"):
        return None
    with th.no_grad():
        tensor = policy.obs_to_tensor(observation)[0]
        if hasattr(policy, "q_net"):
            return _action_values(policy.q_net(tensor)[0].cpu().numpy(), actions)
        if hasattr(policy, "quantile_net"):
            return _action_values(policy.quantile_net(tensor)[0].mean(dim=0).cpu().numpy(), actions)
        if isinstance(policy, ActorCriticPolicy) and not hasattr(policy, "lstm_actor"):
            return _actor_critic_values(policy, tensor, actions)
        if isinstance(getattr(policy, "critic", None), ContinuousCritic):
            action = policy._predict(tensor, deterministic=True)
            value = min(float(q) for q in policy.critic(tensor, action))
            return _command_values(action[0], value, actions)
    return None


def _action_values(row: Sequence[float], actions: Actions) -> PolicyValues:
    scores = dict(zip(actions.names, map(float, row), strict=True))
    low, high = min(scores.values()), max(scores.values())
    limits = dict.fromkeys(scores, (low - 0.2 * (high - low) - 1e-9, high))  # because differences matter
    return PolicyValues(scores, ACTION_VALUES, limits, high)


def _actor_critic_values(policy: ActorCriticPolicy, tensor: th.Tensor, actions: Actions) -> PolicyValues:
    distribution, value = policy.get_distribution(tensor), float(policy.predict_values(tensor))
    if isinstance(distribution, CategoricalDistribution):
        scores = dict(zip(actions.names, distribution.distribution.probs[0].tolist(), strict=True))
        return PolicyValues(scores, "probability of each action", dict.fromkeys(scores, (0.0, 1.0)), value)
    return _command_values(distribution.mode()[0], value, actions)


def _command_values(action: th.Tensor, value: float, actions: Actions) -> PolicyValues:
    names, largest = ("forward speed [m/s]", "turn rate [rad/s]"), np.abs(actions.table).max(axis=0).tolist()
    command = actions.commands(action.cpu().numpy()[None])[0].tolist()
    limits = {name: (-high, high) for name, high in zip(names, largest, strict=True)}
    return PolicyValues(dict(zip(names, command, strict=True)), COMMAND, limits, value)
