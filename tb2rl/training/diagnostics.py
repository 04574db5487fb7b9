"""Diagnostics of a training: names the usual ways of not learning while they happen, with advice."""

from __future__ import annotations

import sys
from collections import deque
from typing import Any

import numpy as np
import torch as th

from tb2rl.training.state import StatefulCallback

_WINDOW = 100  # latest episodes that count
_LEAST = 20  # episodes before anything is said of them
_EARLIEST = 10_000  # [control steps] before, no agent has learned anything
_CHECKS = 100  # in a training
_AT_ONCE = 15  # [control steps] an episode that fails before this gives nothing to learn from
_SLOW = 0.08  # [m/s] the tutorial's robot makes 0.05 while it turns
_SLOW_SHARE = 0.4  # of the fastest command, of a robot that cannot drive much faster than that
_DIVERGED = 10.0  # times the largest value that the rewards allow

ADVICE = {
    "values": "the values are not finite or larger than the rewards allow; try a smaller agent.learning_rate or gamma",
    "failing": "most episodes fail at once; try more exploration, task.start_clearance=0.8, or a longer training",
    "spinning": "it turns on the spot; try a larger task.forward_reward, a smaller task.turn_reward, or gamma nearer 1",
    "flat": "the return has not moved for a third of the budget; try another agent.learning_rate, or more exploration",
}


class TrainingDiagnostics(StatefulCallback):
    """Checks a training periodically; prints advice once for each problem, and logs all of them.

    Args:
        total_timesteps: Control steps of the whole training.
        control_period: Of its task [s].
        max_speed: Of the fastest command [m/s].

    Attributes:
        warned: Whether each part of `ADVICE` was printed.
    """

    saved = ("_next", "_latest", "_history", "_largest_reward", "warned")

    def __init__(self, total_timesteps: int, control_period: float, max_speed: float) -> None:
        super().__init__()
        self.total, self.period, self._slow = total_timesteps, control_period, min(_SLOW, _SLOW_SHARE * max_speed)
        self._next = 0
        self._latest: deque[tuple[float, int, float, bool]] = deque(maxlen=_WINDOW)  # return, length, distance, failed
        self._history: deque[tuple[int, float]] = deque()  # timesteps, mean return
        self._largest_reward = 0.0
        self.warned = dict.fromkeys(ADVICE, False)

    def _on_step(self) -> bool:
        self._largest_reward = max(self._largest_reward, float(np.abs(self.locals["rewards"]).max()))
        for i in np.flatnonzero(self.locals["dones"]):
            info = self.locals["infos"][i]
            self._latest.append((info["episode"]["r"], info["episode"]["l"], info["distance"], info["failed"]))
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + max(1, self.total // _CHECKS)
            self._check()
        return True

    def _check(self) -> None:
        problems = {"values": self._values_diverge()}
        if len(self._latest) >= _LEAST and self.num_timesteps >= _EARLIEST:
            returns, lengths, distances, failed = zip(*self._latest, strict=True)
            self._history.append((self.num_timesteps, float(np.mean(returns))))
            failures = sum(failed) / len(failed)
            late = self.num_timesteps >= self.total / 2
            problems["failing"] = late and failures > 0.9 and float(np.mean(lengths)) < _AT_ONCE
            problems["spinning"] = failures < 0.5 and sum(distances) / (sum(lengths) * self.period) < self._slow
            problems["flat"] = failures > 0.5 and self._return_is_flat()
        for problem, present in problems.items():
            self.logger.record(f"diagnostics/{problem}", float(present))
            if present and not self.warned[problem]:
                self.warned[problem] = True
                print(f"warning: after {self.num_timesteps} steps {ADVICE[problem]}", file=sys.stderr, flush=True)

    def _return_is_flat(self) -> bool:
        """Whether the return of the last third of the budget rises less than a tenth of the episodes' spread."""
        since = self.num_timesteps - self.total / 3
        means = [mean for timesteps, mean in self._history if timesteps >= since]
        half = len(means) // 2
        if self._history[0][0] > since or not half:  # too early, or fewer than two checks
            return False
        spread = float(np.std([latest[0] for latest in self._latest]))
        return float(np.mean(means[half:]) - np.mean(means[:half])) < 0.1 * spread

    def _values_diverge(self) -> bool:
        if not all(bool(th.isfinite(parameter).all()) for parameter in self.model.policy.parameters()):
            return True
        gamma = getattr(self.model, "gamma", 1.0)
        if not gamma < 1.0 or not self._largest_reward:
            return False
        return self._largest_value() > _DIVERGED * self._largest_reward / (1.0 - gamma)

    def _largest_value(self) -> float:
        """The largest value that the policy predicts now; 0 if it has no value function.

        Stable-Baselines3 keeps the last observations and LSTM states in private attributes only.
        """
        model: Any = self.model
        policy = model.policy
        if hasattr(policy, "q"):
            return float(policy.q.abs().max())
        with th.no_grad():
            observations = policy.obs_to_tensor(model._last_obs)[0]
            if hasattr(policy, "q_net"):
                return float(policy.q_net(observations).abs().max())
            if hasattr(model, "_last_lstm_states"):  # a recurrent value function needs its state, too
                starts = th.as_tensor(model._last_episode_starts, dtype=th.float32, device=model.device)
                return float(policy.predict_values(observations, model._last_lstm_states.vf, starts).abs().max())
            if hasattr(policy, "predict_values"):
                return float(policy.predict_values(observations).abs().max())
        return 0.0
