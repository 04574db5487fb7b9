"""Q-table: the action values of discrete states as a Stable-Baselines3 policy, and the compiled Q-learning update."""

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

MAX_PAIRS = 50_000_000  # maximum number of state-action pairs, whose values and visit counts need 800 MB


class Transitions(NamedTuple):
    """One transition of each environment, arrays of shape (num_envs,)."""

    states: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_states: np.ndarray
    terminated: np.ndarray


class UpdateRule(NamedTuple):
    """Parameters of the update."""

    learning_rate: float
    gamma: float
    first_update_is_reward: bool  # store the reward at the first visit of a pair, as the ROS tutorial does
    averaging: float  # least weight of a new value in the running average; 0: the plain mean


@njit(cache=True)
def update_table(q, averages, visits, transitions, rule):
    """Update the arrays in place, one transition after the other, because several may visit the same pair.

    Args:
        q: Action values, shape (states, actions).
        averages: Running averages of `q`, or `q` itself if no averages are needed.
        visits: Visit counts.
        transitions: `Transitions`.
        rule: `UpdateRule`.
    """
    for i in range(transitions.states.size):
        s, a, reward = transitions.states[i], transitions.actions[i], transitions.rewards[i]
        future = 0.0 if transitions.terminated[i] else rule.gamma * q[transitions.next_states[i]].max()
        if rule.first_update_is_reward and visits[s, a] == 0:
            q[s, a] = reward
        else:
            q[s, a] += rule.learning_rate * (reward + future - q[s, a])
        visits[s, a] += 1
        averages[s, a] += max(rule.averaging, 1.0 / visits[s, a]) * (q[s, a] - averages[s, a])


class QTable(BasePolicy):
    """Action values of all states; acts greedily, with ties to the first action.

    Args:
        observation_space: `MultiDiscrete` or `Discrete`.
        action_space: `Discrete`.
        lr_schedule: Unused; Stable-Baselines3 passes it to every policy.
        initial_value: Initial action value; optimistic values, above the true ones, drive exploration.
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
        if not isinstance(observation_space, spaces.MultiDiscrete | spaces.Discrete):
            raise InputError("a Q-table needs discrete observations: set observation=discrete")
        is_single = isinstance(observation_space, spaces.Discrete)
        self._nvec = (int(observation_space.n),) if is_single else tuple(observation_space.nvec.tolist())
        table_shape = num_states, num_actions = math.prod(self._nvec), int(action_space.n)
        if num_states * num_actions > MAX_PAIRS:
            fix = "reduce task.beams, task.range_bins or task.frame_stack"
            raise InputError(f"a Q-table of {num_states} states is too large; {fix}")
        self.q = th.nn.Parameter(th.full(table_shape, initial_value, dtype=th.float64), requires_grad=False)
        self.visits = th.nn.Parameter(th.zeros(table_shape, dtype=th.int64), requires_grad=False)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("observation_space", "action_space", "initial_value")}

    def _save_to_state_dict(self, destination: dict[str, Any], prefix: str, keep_vars: bool) -> None:
        """Save the visited pairs only, which are often a hundredth of the table."""
        pairs = self.visits.flatten().nonzero().flatten()
        destination[f"{prefix}pairs"] = pairs
        destination[f"{prefix}q"] = self.q.flatten()[pairs]
        destination[f"{prefix}visits"] = self.visits.flatten()[pairs]

    def _load_from_state_dict(self, state_dict: Mapping[str, th.Tensor], prefix: str, *_: Any) -> None:
        pairs, q, visits = (state_dict[f"{prefix}{name}"] for name in ("pairs", "q", "visits"))
        if not pairs.shape == q.shape == visits.shape or (pairs < 0).any() or (visits < 1).any():
            raise ValueError("pairs, q and visits of the Q-table are inconsistent")
        for values, initial_value, stored in ((self.q, self.initial_value, q), (self.visits, 0, visits)):
            values.fill_(initial_value).view(-1)[pairs] = stored

    def states(self, observations: np.ndarray) -> np.ndarray:
        """The state number (row of the table) of each observation, shape (num_envs,)."""
        columns = np.asarray(observations).reshape(-1, len(self._nvec)).T
        return np.ravel_multi_index(tuple(columns), self._nvec)

    def best_actions(self) -> np.ndarray:
        """The greedy action of every state, shape (states,)."""
        return self.q.detach().numpy().argmax(axis=1)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[np.ndarray, Any]:
        """The greedy actions, also with `deterministic=False`. Uses numpy, which is faster here than torch."""
        observation = np.asarray(observation)
        actions = self.q.detach().numpy()[self.states(observation)].argmax(axis=1)
        return (actions if observation.ndim == len(self.observation_space.shape) + 1 else actions[0]), state

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        return th.as_tensor(self.predict(observation.cpu().numpy())[0])
