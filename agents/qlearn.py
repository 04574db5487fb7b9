"""Tabular Q-learning (Watkins 1989; Sutton & Barto 2018, section 6.5) as a Stable-Baselines3 algorithm.

The table is a policy, so `learn`, `predict`, `save`, `load`, callbacks and loggers work as for DQN. Each step of n
environments makes n updates in compiled code.
"""

import time
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
import torch as th
from annotated_types import Gt, Le
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import LinearSchedule, safe_mean

from tb2rl import Agent
from tb2rl.agents._qtable import QTable, Transitions, UpdateRule, update_table
from tb2rl.core.values import Fraction

AGENT = Agent(
    "tb2rl.agents.qlearn:QLearning", policy="QTable", observation="discrete", fixed_obs_mode=True, actions="discrete"
)


class QLearning(BaseAlgorithm):
    """Q-learning with a table.

    Args:
        policy: "QTable".
        env: One or more environments with discrete observations and actions.
        learning_rate: Step size alpha: a number, or a function of the remaining progress (1 to 0).
        gamma: Discount factor.
        exploration: "epsilon_greedy" takes a random action with probability epsilon. "noisy_values" (of
            the ROS tutorial, see FROM_ROS.md) adds uniform noise to the values of the state with probability epsilon;
            the width of the noise is the largest |value|.
        exploration_initial_eps: Epsilon at the start of the training.
        exploration_final_eps: Epsilon after the decrease.
        exploration_fraction: Fraction of the training over which epsilon decreases linearly.
        exploration_decay: Factor that multiplies epsilon at the start of each episode until `exploration_final_eps` is
            reached. None: linear decrease.
        update: "textbook" or "tutorial". "tutorial" sets the value of a state-action pair to the reward at its
            first visit, and also bootstraps from terminal states.
        averaging: The policy is greedy on running averages of the action values, because a large step size makes the
            values oscillate (Polyak & Juditsky 1992). A new value has the weight 1 / visits, but at least `averaging`.
            Exploration and update targets use the values, not the averages. None: no averages.
        device: Ignored, because the table is on the CPU.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"QTable": QTable}
    policy: QTable

    def __init__(
        self,
        policy: str | type[QTable],
        env: GymEnv | str | None,
        learning_rate: float | Schedule = 0.1,
        gamma: Fraction = 0.98,
        exploration: Literal["epsilon_greedy", "noisy_values"] = "epsilon_greedy",
        exploration_initial_eps: Fraction = 1.0,
        exploration_final_eps: Fraction = 0.02,
        exploration_fraction: Fraction = 0.8,
        exploration_decay: Fraction | None = None,
        update: Literal["textbook", "tutorial"] = "textbook",
        averaging: Annotated[float, Gt(0), Le(1)] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            policy,
            env,
            learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            device="cpu",
            support_multi_env=True,
            seed=seed,
            supported_action_spaces=(spaces.Discrete,),
        )
        self.gamma = gamma
        self.exploration = exploration
        self.exploration_initial_eps = exploration_initial_eps
        self.exploration_final_eps = exploration_final_eps
        self.exploration_fraction = exploration_fraction
        self.exploration_decay = exploration_decay
        self.update = update
        self.averaging = averaging
        self._unaveraged_q: np.ndarray | None = None  # the action values, if the policy holds their averages
        self.exploration_rate = exploration_initial_eps
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self._rng = np.random.default_rng(self.seed)
        self._logged_at = 0
        fraction = max(self.exploration_fraction, 1e-9)  # 0: final epsilon from the start
        self.exploration_schedule = LinearSchedule(self.exploration_initial_eps, self.exploration_final_eps, fraction)
        self.policy = self.policy_class(
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        )
        if self.averaging is not None and self._unaveraged_q is None:  # `load` may have restored `_unaveraged_q` before
            self._unaveraged_q = np.full(self.policy.q.shape, np.nan)

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int = 100,
        tb_log_name: str = "QLearning",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        total_timesteps, callback = self._setup_learn(
            total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar
        )
        assert self.env is not None
        if np.isnan(self._values[0, 0]):  # NaN: `_unaveraged_q` is new, and starts with the values of the policy
            self._values[:] = self.policy.q.numpy()
        if reset_num_timesteps:
            self.exploration_rate = self.exploration_initial_eps
            self._update_epsilon(self.env.num_envs)
        callback.on_training_start(locals(), globals())
        states = self.policy.states(self._last_obs)
        while self.num_timesteps < total_timesteps:
            callback.on_rollout_start()
            actions = self._sample_actions(states)
            observations, rewards, dones, infos = self.env.step(actions)
            self.num_timesteps += self.env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                break
            self._update_info_buffer(infos, dones)
            self._update_current_progress_remaining(self.num_timesteps, total_timesteps)

            new_states = self.policy.states(observations)
            next_states, terminated = self._next_states(new_states, dones, infos)
            self._update(Transitions(states, actions, rewards, next_states, terminated))
            states, self._last_obs = new_states, observations
            if dones.any():
                self._episode_num += int(dones.sum())
                if log_interval is not None and self._episode_num % log_interval < dones.sum():
                    self.dump_logs()
            self._update_epsilon(int(dones.sum()))
        if log_interval is not None and self._logged_at != self.num_timesteps:
            self.dump_logs()
        callback.on_training_end()
        return self

    def dump_logs(self) -> None:
        """Write statistics to the logger."""
        self._logged_at = self.num_timesteps
        if self.ep_info_buffer:
            self.logger.record("rollout/ep_rew_mean", safe_mean([info["r"] for info in self.ep_info_buffer]))
            self.logger.record("rollout/ep_len_mean", safe_mean([info["l"] for info in self.ep_info_buffer]))
        if self.ep_success_buffer:
            self.logger.record("rollout/success_rate", safe_mean(self.ep_success_buffer))
        seconds = max((time.time_ns() - self.start_time) / 1e9, 1e-9)
        self.logger.record("time/episodes", self._episode_num)
        self.logger.record("time/fps", int((self.num_timesteps - self._num_timesteps_at_start) / seconds))
        self.logger.record("rollout/exploration_rate", self.exploration_rate)
        self.logger.record("train/learning_rate", self.lr_schedule(self._current_progress_remaining))
        self.logger.record("train/visited_share", float((self.policy.visits > 0).float().mean()))
        self.logger.dump(step=self.num_timesteps)

    def _next_states(
        self, new_states: np.ndarray, dones: np.ndarray, infos: list[dict]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the next states (of finished episodes: the final states) and the mask of terminal states."""
        if not dones.any():
            return new_states, dones
        next_states, terminated = new_states.copy(), dones.copy()
        for i in np.flatnonzero(dones):
            next_states[i] = self.policy.states(infos[i]["terminal_observation"])[0]
            terminated[i] = not infos[i].get("TimeLimit.truncated", False)
        return next_states, terminated

    def _update(self, transitions: Transitions) -> None:
        is_tutorial = self.update == "tutorial"
        if is_tutorial:
            transitions = transitions._replace(terminated=np.zeros_like(transitions.terminated))
        learning_rate = self.lr_schedule(self._current_progress_remaining)
        rule = UpdateRule(learning_rate, self.gamma, is_tutorial, self.averaging or 0.0)
        update_table(self._values, self.policy.q.numpy(), self.policy.visits.numpy(), transitions, rule)

    @property
    def _values(self) -> np.ndarray:
        """The learned action values, shape (states, actions)."""
        return self.policy.q.numpy() if self._unaveraged_q is None else self._unaveraged_q

    def _sample_actions(self, states: np.ndarray) -> np.ndarray:
        """Sample actions with exploration, and break ties at random."""
        values = self._values[states]
        is_exploring = self._rng.random(len(states)) < self.exploration_rate
        if self.exploration == "noisy_values":
            noise_width = np.abs(values).max(axis=1) * is_exploring
            values = values + noise_width[:, None] * (self._rng.random(values.shape) - 0.5)
        is_best = values == values.max(axis=1, keepdims=True)
        best = (is_best * self._rng.random(values.shape)).argmax(axis=1)
        if self.exploration == "noisy_values":
            return best
        return np.where(is_exploring, self._rng.integers(values.shape[1], size=len(states)), best)

    def _update_epsilon(self, new_episodes: int) -> None:
        """Update epsilon after a step in which `new_episodes` episodes started."""
        if self.exploration_decay is None:
            self.exploration_rate = self.exploration_schedule(self._current_progress_remaining)
            return
        for _ in range(new_episodes):
            if self.exploration_rate > self.exploration_final_eps:
                self.exploration_rate *= self.exploration_decay

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "exploration_schedule"]
