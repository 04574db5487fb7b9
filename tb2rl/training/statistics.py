"""Statistics of a training's episodes, for TensorBoard and in the ROS tutorial's format (FROM_ROS.md), and advice."""

import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.logger import TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from tb2rl.core.errors import InputError
from tb2rl.evaluation.metrics import spinning_speed
from tb2rl.runs.config import Config
from tb2rl.training.error_translation import has_finite_weights
from tb2rl.training.state import StatefulCallback

_WINDOW = 100  # number of latest episodes for running statistics and diagnostics
_MIN_EPISODES = 20  # number of episodes that the checks of episodes need
_WARM_UP_STEPS = 10_000  # [control steps] after which checks of episodes start, because no agent learns earlier
_NUM_CHECKS = 100  # checks per training
_SHORT_EPISODE = 15  # [control steps] shorter episodes are too short to learn from
_DIVERGENCE_FACTOR = 10.0  # predicted values diverge above this multiple of the largest possible return

ADVICE = {  # each ends with its entry in the page of symptoms
    "values": "the values are not finite or larger than the rewards allow; try a smaller agent.learning_rate or gamma"
    " (docs/troubleshooting.md#values-diverge)",
    "failing": "most episodes fail at once; try more exploration, task.start_clearance=0.8, or a longer training"
    " (docs/troubleshooting.md#it-fails-at-once)",
    "spinning": "the robot spins; try a larger task.forward_reward, a smaller task.turn_reward, or gamma nearer 1"
    " (docs/troubleshooting.md#it-spins)",
    "flat": "the return has not risen for a third of the budget; try another agent.learning_rate, or more exploration"
    " (docs/troubleshooting.md#the-return-does-not-rise)",
}


class EpisodeStatistics(StatefulCallback):
    """Logs running failure rate and distance of episodes, and stops the training after `max_episodes`.

    Args:
        max_episodes: Number of episodes in all environments after which to stop; None: no limit.
        verbose: 1 prints the tutorial's line for each episode.

    Attributes:
        latest: The latest episodes as tuples: return, control steps, distance [m], whether it failed.
        lengths: Control steps of each episode so far.
    """

    saved_attributes = ("latest", "lengths")

    def __init__(self, max_episodes: int | None, verbose: int) -> None:
        super().__init__(verbose)
        self.latest: deque[tuple[float, int, float, bool]] = deque(maxlen=_WINDOW)
        self.lengths: deque[int] = deque()
        self._max_episodes, self._start_time = max_episodes, time.monotonic()

    def _on_step(self) -> bool:
        if "dones" not in self.locals:  # as with the algorithm ARS, which evaluates whole policies
            name = type(self.model).__name__
            raise InputError(f"{name} does not pass rewards, dones and infos to callbacks; choose another algorithm")
        done_envs = np.flatnonzero(self.locals["dones"])
        for i in done_envs:
            info = self.locals["infos"][i]
            episode = info["episode"]
            self.latest.append((episode["r"], episode["l"], info["distance"], info["failed"]))
            self.lengths.append(episode["l"])
            if self.verbose:
                print(self._tutorial_line(episode), flush=True)
        if done_envs.size:
            _, _, distances, failed = zip(*self.latest, strict=True)
            self.logger.record("rollout/failure_rate", sum(failed) / len(failed))
            self.logger.record("rollout/distance_mean", sum(distances) / len(distances))
        return self._max_episodes is None or len(self.lengths) < self._max_episodes

    def _tutorial_line(self, episode: Mapping[str, float]) -> str:
        schedule = getattr(self.model, "lr_schedule", None)
        alpha = schedule(self.model._current_progress_remaining) if schedule else float("nan")
        gamma, epsilon = getattr(self.model, "gamma", None), getattr(self.model, "exploration_rate", None)
        numbers = {"alpha": alpha, "gamma": gamma, "epsilon": epsilon}
        shown = " - ".join(f"{name}: {value:.4g}" for name, value in numbers.items() if value is not None)
        elapsed = timedelta(seconds=int(time.monotonic() - self._start_time))
        reward = f"Reward: {episode['r']:.0f} - Steps: {episode['l']}"
        return f"EP: {len(self.lengths)} - [{shown}] - {reward} - Time: {elapsed}"


def tutorial_scores(lengths: Sequence[int]) -> str:
    """Describe the tutorial's final scores: mean length of all episodes, and of the 100 longest."""
    if not lengths:
        return "no episode ended"
    longest = sorted(lengths, reverse=True)[:100]
    return f"overall score: {np.mean(lengths):.1f} steps, best {len(longest)} score: {np.mean(longest):.1f} steps"


class TensorBoard(TensorBoardOutputFormat):
    """Writes Stable-Baselines3's event files; a resumed training replaces events after its checkpoint.

    Args:
        folder: Folder for the event files.
        timesteps: Control steps at the checkpoint of a resumed training, else 0.
        hyperparameters: Plain values by dotted key, for the table of all runs.
    """

    def __init__(self, folder: Path, timesteps: int, hyperparameters: Mapping[str, Any]) -> None:
        self.writer = SummaryWriter(log_dir=str(folder), purge_step=timesteps + 1 if timesteps else None)
        self._is_closed = False
        # The first summary lists the columns of the table, and TensorBoard would use the list of one run for all runs.
        # Without a list, TensorBoard collects the columns of all runs.
        _columns, *summaries = hparams(dict(hyperparameters), {})
        for summary in summaries:  # `SummaryWriter` has no public method for a single summary
            self.writer._get_file_writer().add_summary(summary)


class TrainingDiagnostics(StatefulCallback):
    """Checks a training periodically; logs all problems, and prints advice once for each."""

    saved_attributes = ("_next", "_history", "_largest_reward", "_warned")

    def __init__(self, config: Config, statistics: EpisodeStatistics) -> None:
        super().__init__()
        self._statistics, self._total_timesteps = statistics, config.train.total_timesteps
        self._control_period = config.task.control_period
        self._spinning_speed = spinning_speed(config.scene.actions.max_speed)
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
            if is_present:
                self.warn(problem)

    def warn(self, problem: str) -> None:
        """Print the advice for a problem, once."""
        if not self._warned[problem]:
            print(f"warning: after {self.num_timesteps} steps {ADVICE[problem]}", file=sys.stderr, flush=True)
        self._warned[problem] = True

    def _return_is_flat(self, std: float) -> bool:
        """Whether the mean return rose by less than 0.1 `std` in the latest window, a third of the training long."""
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
        """The largest absolute value that the policy predicts; 0 if it cannot be read, as in SAC, or does not exist."""
        model: Any = self.model
        if hasattr(model, "rollout_buffer"):  # on-policy algorithms: the values of the latest rollout
            return float(np.abs(model.rollout_buffer.values).max())
        if hasattr(model.policy, "q"):
            return float(model.policy.q.abs().max())
        if not hasattr(model.policy, "q_net"):
            return 0.0
        with th.no_grad():
            return float(model.policy.q_net(model.policy.obs_to_tensor(model._last_obs)[0]).abs().max())
