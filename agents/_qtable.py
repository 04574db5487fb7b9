"""The table of Q-learning: action values of discrete states, as a Stable-Baselines3 policy, and its compiled update."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import Schedule

from tb2rl.core.compiled import njit
from tb2rl.core.errors import InputError

LARGEST = 50_000_000  # values in a table; 800 MB with their visits


class Table(NamedTuple):
    """Arrays of shape (states, actions) that an update changes in place.

    Attributes:
        values: Action values.
        averages: Running averages of the values; the array may be `values` itself.
        visits: Updates of each pair so far.
    """

    values: np.ndarray
    averages: np.ndarray
    visits: np.ndarray


class Transitions(NamedTuple):
    """Steps of all environments, arrays of shape (num_envs,)."""

    states: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_states: np.ndarray
    terminated: np.ndarray


class Rule(NamedTuple):
    """An update rule.

    Attributes:
        plain_first: Whether the first visit of a pair stores the plain reward, as the tutorial does.
        share: Weight of a new value in its average; the first values have equal weights.
    """

    learning_rate: float
    gamma: float
    plain_first: bool
    share: float


@njit(cache=True)
def update_table(table, transitions, rule):
    """Update the table by one transition after the other, so that repeated pairs all count."""
    q, averages, visits = table
    for i in range(transitions.states.size):
        s, a, reward = transitions.states[i], transitions.actions[i], transitions.rewards[i]
        future = 0.0 if transitions.terminated[i] else rule.gamma * q[transitions.next_states[i]].max()
        if rule.plain_first and visits[s, a] == 0:
            q[s, a] = reward
        else:
            q[s, a] += rule.learning_rate * (reward + future - q[s, a])
        visits[s, a] += 1
        averages[s, a] += max(rule.share, 1.0 / visits[s, a]) * (q[s, a] - averages[s, a])


class QTable(BasePolicy):
    """Action values of every discrete state; the greedy action is the first of the best ones.

    Args:
        observation_space: `MultiDiscrete` or `Discrete`.
        action_space: `Discrete`.
        lr_schedule: Unused; Stable-Baselines3 passes it to every policy.
        initial_value: Of every pair; above the true values it drives exploration.
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Discrete,
        lr_schedule: Schedule | None = None,
        initial_value: float = 0.0,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.initial_value = initial_value
        if isinstance(observation_space, spaces.MultiDiscrete):
            self.shape = tuple(int(n) for n in observation_space.nvec)
        elif isinstance(observation_space, spaces.Discrete):
            self.shape = (int(observation_space.n),)
        else:
            raise InputError("a Q-table needs observation=discrete: distance classes, not raw ranges")
        states, actions = math.prod(self.shape), int(action_space.n)
        if states * actions > LARGEST:
            raise InputError(
                f"a table of {states} states is too large; take fewer task.beams, task.range_bins or task.frame_stack"
            )
        self.q = th.nn.Parameter(th.full((states, actions), initial_value, dtype=th.float64), requires_grad=False)
        self.visits = th.nn.Parameter(th.zeros((states, actions), dtype=th.int64), requires_grad=False)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        names = ("observation_space", "action_space", "initial_value")
        return {name: getattr(self, name) for name in names}

    def _save_to_state_dict(self, destination: dict[str, Any], prefix: str, keep_vars: bool) -> None:
        """Save only the pairs that were visited, often one in a hundred."""
        pairs = self.visits.flatten().nonzero().flatten()
        destination[f"{prefix}pairs"] = pairs
        destination[f"{prefix}q"] = self.q.flatten()[pairs]
        destination[f"{prefix}visits"] = self.visits.flatten()[pairs]

    def _load_from_state_dict(
        self,
        state_dict: Mapping[str, th.Tensor],
        prefix: str,
        local_metadata: Mapping[str, Any],
        strict: bool,
        missing_keys: list[str],
        unexpected_keys: list[str],
        error_msgs: list[str],
    ) -> None:
        names = [f"{prefix}{name}" for name in ("pairs", "q", "visits")]
        missing_keys += [name for name in names if name not in state_dict]
        unexpected_keys += [name for name in state_dict if name not in names]
        if missing_keys:
            return
        pairs, q, visits = (state_dict[name] for name in names)
        limits = th.cat([th.tensor([-1]), pairs.flatten(), th.tensor([self.q.numel()])])
        if (pairs.dtype, q.dtype, visits.dtype) != (th.int64, th.float64, th.int64):
            error_msgs.append("the table's pairs, q and visits have another type")
        elif not pairs.shape == q.shape == visits.shape == (pairs.numel(),):
            error_msgs.append("the table's pairs, q and visits are not equally many")
        elif not (limits[1:] > limits[:-1]).all() or not (visits > 0).all():
            error_msgs.append("the table's pairs are not in order, not in the table, or not visited")
        else:
            for values, initial, saved in ((self.q, self.initial_value, q), (self.visits, 0, visits)):
                values.fill_(initial).view(-1)[pairs] = saved

    def states(self, observations: np.ndarray) -> np.ndarray:
        """The table's row of each observation, shape (num_envs,)."""
        columns = np.asarray(observations).reshape(-1, len(self.shape)).T
        return np.ravel_multi_index(tuple(columns), self.shape)

    def best_actions(self) -> np.ndarray:
        """The greedy action of each row, shape (states,)."""
        return self.q.detach().numpy().argmax(axis=1)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[np.ndarray, Any]:
        """The greedy actions, without torch for speed; a table has no distribution to sample from."""
        observation = np.asarray(observation)
        actions = self.q.detach().numpy()[self.states(observation)].argmax(axis=1)
        return (actions if observation.ndim == len(self.observation_space.shape) + 1 else actions[0]), state

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        return th.as_tensor(self.predict(observation.cpu().numpy())[0])
