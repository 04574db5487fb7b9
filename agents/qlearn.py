"""Tabular Q-learning (Watkins 1989; Sutton & Barto 2018, section 6.5) as a Stable-Baselines3 algorithm.

The table is a policy: `learn`, `predict`, `save`, `load`, callbacks and loggers work as for DQN. One step of n
environments makes n updates, in compiled code.
"""

from __future__ import annotations

import time
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
import torch as th
from annotated_types import Gt, Le
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import LinearSchedule, safe_mean

from tb2rl import Agent
from tb2rl.agents._qtable import QTable, Rule, Table, Transitions, update_table
from tb2rl.core.values import Fraction

AGENT = Agent("tb2rl.agents.qlearn:QLearning", policy="QTable", observation="discrete", only=True, actions="named")

Self = TypeVar("Self", bound="QLearning")


class QLearning(BaseAlgorithm):
    """Off-policy temporal-difference control with a table.

    Args:
        policy: "QTable".
        env: Environments with discrete observations and actions, any number of them.
        learning_rate: Step size alpha, a number or a schedule of the remaining progress.
        gamma: Discount factor.
        exploration: "epsilon_greedy": with probability epsilon a random action. "noisy_values" (the tutorial's): with
            probability epsilon the best value after adding uniform noise, as wide as the largest |value| of the state.
        exploration_initial_eps, exploration_final_eps: Epsilon at the start and at the end.
        exploration_fraction: Share of the training over which epsilon falls linearly.
        exploration_decay: A factor for epsilon at the start of each episode, while it is above `exploration_final_eps`,
            instead of the linear fall.
        update: "textbook", or "tutorial": the first visit of a pair stores the plain reward, and episodes that ended
            bootstrap like any other step.
        averaging: Weight of a new value in running averages (Polyak & Juditsky 1992), by which the policy acts;
            exploration and targets still use the values themselves. None: the policy acts by the values, which a large
            step size moves up and down.
        device: Accepted for compatibility; ignored, because numpy reads the table.
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
        self._latest: np.ndarray | None = None
        self.exploration_rate = exploration_initial_eps
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self._rng = np.random.default_rng(self.seed)
        self._logged_at = 0
        fraction = max(self.exploration_fraction, 1e-9)  # 0: greedy from the start
        self.exploration_schedule = LinearSchedule(self.exploration_initial_eps, self.exploration_final_eps, fraction)
        self.policy = self.policy_class(
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        )
        self.policy = self.policy.to(self.device)
        if self.averaging is not None and self._latest is None:  # a loaded learner has them already
            self._latest = np.full(self.policy.q.shape, np.nan)  # the values; the policy holds their averages

    def learn(
        self: Self,
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
        if np.isnan(self._values[0, 0]):  # a new learner, or one with a loaded policy
            self._values[:] = self.policy.q.numpy()
        if reset_num_timesteps:
            self.exploration_rate = self.exploration_initial_eps
            self._update_epsilon(self.env.num_envs)
        callback.on_training_start(locals(), globals())
        self.policy.set_training_mode(True)
        states = self.policy.states(self._last_obs)
        while self.num_timesteps < total_timesteps:
            callback.on_rollout_start()
            actions = self._choose(states)
            observations, rewards, dones, infos = self.env.step(actions)
            self.num_timesteps += self.env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                break
            self._update_info_buffer(infos, dones)
            self._update_current_progress_remaining(self.num_timesteps, total_timesteps)

            next_states = self.policy.states(observations)
            reached, terminated = self._final_states(next_states, dones, infos)
            self._update(Transitions(states, actions, rewards, reached, terminated))
            states, self._last_obs = next_states, observations
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

    def _final_states(self, states: np.ndarray, dones: np.ndarray, infos: list[dict]) -> tuple[np.ndarray, np.ndarray]:
        """The states after the steps, before environments were reset, and whether they are terminal."""
        if not dones.any():
            return states, dones
        reached, terminated = states.copy(), dones.copy()
        for i in np.flatnonzero(dones):
            reached[i] = self.policy.states(infos[i]["terminal_observation"])[0]
            terminated[i] = not infos[i].get("TimeLimit.truncated", False)
        return reached, terminated

    def _update(self, transitions: Transitions) -> None:
        is_tutorial = self.update == "tutorial"
        if is_tutorial:
            transitions = transitions._replace(terminated=np.zeros_like(transitions.terminated))
        table = Table(self._values, self.policy.q.numpy(), self.policy.visits.numpy())
        learning_rate = self.lr_schedule(self._current_progress_remaining)
        update_table(table, transitions, Rule(learning_rate, self.gamma, is_tutorial, self.averaging or 0.0))

    @property
    def _values(self) -> np.ndarray:
        """The learned values, shape (states, actions)."""
        return self.policy.q.numpy() if self._latest is None else self._latest

    def _choose(self, states: np.ndarray) -> np.ndarray:
        """Actions with exploration; ties are broken at random."""
        values = self._values[states]
        explores = self._rng.random(len(states)) < self.exploration_rate
        if self.exploration == "noisy_values":
            width = np.abs(values).max(axis=1) * explores
            values = values + width[:, None] * (self._rng.random(values.shape) - 0.5)
        ties = values == values.max(axis=1, keepdims=True)
        best = (ties * self._rng.random(values.shape)).argmax(axis=1)
        if self.exploration == "noisy_values":
            return best
        return np.where(explores, self._rng.integers(values.shape[1], size=len(states)), best)

    def _update_epsilon(self, started: int) -> None:
        """Reduce epsilon after a step in which `started` episodes began."""
        if self.exploration_decay is None:
            self.exploration_rate = self.exploration_schedule(self._current_progress_remaining)
            return
        for _ in range(started):
            if self.exploration_rate > self.exploration_final_eps:
                self.exploration_rate *= self.exploration_decay

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "exploration_schedule"]
