"""Episode statistics of a training, for TensorBoard and for printed lines in the format of the ROS tutorial."""

import time
from collections import deque
from collections.abc import Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from tb2rl.core.errors import InputError
from tb2rl.training.state import StatefulCallback

_WINDOW = 100  # number of latest episodes for running statistics and diagnostics


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
        if "dones" not in self.locals:  # such as ARS, which evaluates whole policies
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
            _, _, distance, failure_rate = np.mean(self.latest, axis=0)
            self.logger.record("rollout/failure_rate", float(failure_rate))
            self.logger.record("rollout/distance_mean", float(distance))
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
