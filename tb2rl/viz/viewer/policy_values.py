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


@dataclass(frozen=True)
class PolicyValues:
    """Numbers of a policy for one observation."""

    scores: dict[str, float]  # by action, or by component of the command
    meaning: str  # of the scores, such as "probability of each action"
    value: float | None = None  # expected return from the critic; None: the policy has no critic


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
            return PolicyValues(_command(action[0], actions), COMMAND, value)
    return None


def _action_values(row: Sequence[float], actions: Actions) -> PolicyValues:
    scores = dict(zip(actions.names, map(float, row), strict=True))
    return PolicyValues(scores, "expected return of each action", max(scores.values()))


def _actor_critic_values(policy: ActorCriticPolicy, tensor: th.Tensor, actions: Actions) -> PolicyValues:
    distribution, value = policy.get_distribution(tensor), float(policy.predict_values(tensor))
    if isinstance(distribution, CategoricalDistribution):
        probabilities = distribution.distribution.probs[0].tolist()
        return PolicyValues(dict(zip(actions.names, probabilities, strict=True)), "probability of each action", value)
    return PolicyValues(_command(distribution.mode()[0], actions), COMMAND, value)


def _command(action: th.Tensor, actions: Actions) -> dict[str, float]:
    v, w = actions.commands(action.cpu().numpy()[None])[0].tolist()
    return {"v [m/s]": v, "w [rad/s]": w}
