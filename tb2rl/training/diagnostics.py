"""Diagnostics of a training: detects common learning failures early, and prints advice."""

import sys
from collections import deque
from typing import Any

import numpy as np
import torch as th

from tb2rl.runs.config import Config
from tb2rl.training.error_translation import has_finite_weights
from tb2rl.training.state import StatefulCallback
from tb2rl.training.statistics import EpisodeStatistics

_MIN_EPISODES = 20  # number of episodes that the checks of episodes need
_WARM_UP_STEPS = 10_000  # [control steps] checks of episodes start later, because no agent learns earlier
_NUM_CHECKS = 100  # checks per training
_SHORT_EPISODE = 15  # [control steps] shorter episodes are too short to learn from
_SPINNING_SPEED = 0.08  # [m/s] mean speed below which a robot spins; the tutorial's robot drives at 0.05 m/s in turns
_SPINNING_FRACTION = 0.4  # fraction of the largest speed command that replaces _SPINNING_SPEED for slow robots
_DIVERGENCE_FACTOR = 10.0  # predicted values diverge above this multiple of the largest possible return

ADVICE = {
    "values": "the values are not finite or larger than the rewards allow; try a smaller agent.learning_rate or gamma",
    "failing": "most episodes fail at once; try more exploration, task.start_clearance=0.8, or a longer training",
    "spinning": "the robot spins; try a larger task.forward_reward, a smaller task.turn_reward, or gamma nearer 1",
    "flat": "the return has not moved for a third of the budget; try another agent.learning_rate, or more exploration",
}


class TrainingDiagnostics(StatefulCallback):
    """Checks a training periodically; logs all problems, and prints advice once for each."""

    saved_attributes = ("_next", "_history", "_largest_reward", "_warned")

    def __init__(self, config: Config, statistics: EpisodeStatistics) -> None:
        super().__init__()
        self._statistics, self._total_timesteps = statistics, config.train.total_timesteps
        self._control_period = config.task.control_period
        self._spinning_speed = min(_SPINNING_SPEED, _SPINNING_FRACTION * config.scene.actions.max_speed)
        self._next = 0  # timesteps of the next check
        self._history: deque[tuple[int, float]] = deque()  # timesteps, mean return
        self._largest_reward = 0.0
        self._warned = dict.fromkeys(ADVICE, False)

    def _on_step(self) -> bool:
        self._largest_reward = max(self._largest_reward, float(np.abs(self.locals["rewards"]).max()))
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + max(1, self._total_timesteps // _NUM_CHECKS)
            self._check()
        return True

    def _check(self) -> None:
        problems = {"values": self._values_diverge()}
        latest = self._statistics.latest
        if len(latest) >= _MIN_EPISODES and self.num_timesteps >= _WARM_UP_STEPS:
            returns, lengths, distances, failed = zip(*latest, strict=True)
            self._history.append((self.num_timesteps, float(np.mean(returns))))
            failure_rate = sum(failed) / len(failed)
            mean_speed = sum(distances) / (sum(lengths) * self._control_period)
            in_second_half = self.num_timesteps >= self._total_timesteps / 2
            problems["failing"] = in_second_half and failure_rate > 0.9 and float(np.mean(lengths)) < _SHORT_EPISODE
            problems["spinning"] = failure_rate < 0.5 and mean_speed < self._spinning_speed
            problems["flat"] = failure_rate > 0.5 and self._return_is_flat(float(np.std(returns)))
        for problem, is_present in problems.items():
            self.logger.record(f"diagnostics/{problem}", float(is_present))
            if is_present and not self._warned[problem]:
                self._warned[problem] = True
                print(f"warning: after {self.num_timesteps} steps {ADVICE[problem]}", file=sys.stderr, flush=True)

    def _return_is_flat(self, std: float) -> bool:
        """Whether the mean return rises by less than a tenth of `std` in the last third of the budget."""
        window_start = self.num_timesteps - self._total_timesteps / 3
        means = [mean for timesteps, mean in self._history if timesteps >= window_start]
        half = len(means) // 2
        if self._history[0][0] > window_start or not half:  # too early, or fewer than two checks
            return False
        return float(np.mean(means[half:]) - np.mean(means[:half])) < 0.1 * std

    def _values_diverge(self) -> bool:
        if not has_finite_weights(self.model):
            return True
        gamma = getattr(self.model, "gamma", 1.0)
        if not gamma < 1.0 or not self._largest_reward:
            return False
        return self._largest_value() > _DIVERGENCE_FACTOR * self._largest_reward / (1.0 - gamma)

    def _largest_value(self) -> float:
        """The largest absolute value that the policy predicts; 0 if it has no value function."""
        model: Any = self.model
        if hasattr(model, "rollout_buffer"):  # on-policy algorithms: the values of the latest rollout
            return float(np.abs(model.rollout_buffer.values).max())
        if hasattr(model.policy, "q"):
            return float(model.policy.q.abs().max())
        if not hasattr(model.policy, "q_net"):
            return 0.0
        with th.no_grad():
            return float(model.policy.q_net(model.policy.obs_to_tensor(model._last_obs)[0]).abs().max())
