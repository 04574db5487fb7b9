"""Episode statistics of a training: for TensorBoard, and as the lines that the ROS tutorial prints."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from tb2rl.core.errors import InputError
from tb2rl.training.state import StatefulCallback

_WINDOW = 100  # episodes in a running mean


class EpisodeStatistics(StatefulCallback):
    """Logs running failure rate and distance of episodes.

    Attributes:
        lengths: Control steps of each episode so far.
    """

    saved = ("_failed", "_distances", "lengths")

    def __init__(self) -> None:
        super().__init__()
        self._failed: deque[bool] = deque(maxlen=_WINDOW)
        self._distances: deque[float] = deque(maxlen=_WINDOW)
        self.lengths: deque[int] = deque()

    def _on_step(self) -> bool:
        if "dones" not in self.locals:  # ARS, which rates whole policies, or a user's algorithm
            name = type(self.model).__name__
            raise InputError(f"{name} does not tell its callbacks of every step (rewards, dones, infos), as others do")
        ended = np.flatnonzero(self.locals["dones"])
        for i in ended:
            info = self.locals["infos"][i]
            self._failed.append(info["failed"])
            self._distances.append(info["distance"])
            self.lengths.append(info["episode"]["l"])
        if ended.size:
            self.logger.record("rollout/failure_rate", sum(self._failed) / len(self._failed))
            self.logger.record("rollout/distance_mean", float(np.mean(self._distances)))
        return True


class EpisodeLines(BaseCallback):
    """Prints the tutorial's line for each episode."""

    def __init__(self) -> None:
        super().__init__()
        self._episodes = 0
        self._started = time.monotonic()

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]):
            self._episodes += 1
            print(self._line(self.locals["infos"][i]["episode"]), flush=True)
        return True

    def _line(self, episode: Mapping[str, float]) -> str:
        schedule = getattr(self.model, "lr_schedule", None)
        alpha = schedule(self.model._current_progress_remaining) if schedule else float("nan")  # there is no public one
        numbers = [("alpha", alpha), ("gamma", getattr(self.model, "gamma", None))]
        numbers.append(("epsilon", getattr(self.model, "exploration_rate", None)))
        shown = " - ".join(f"{name}: {value:.4g}" for name, value in numbers if value is not None)
        minutes, seconds = divmod(int(time.monotonic() - self._started), 60)
        return (
            f"EP: {self._episodes} - [{shown}] - Reward: {episode['r']:.0f} - Steps: {episode['l']} - "
            f"Time: {minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
        )


def tutorial_scores(lengths: Sequence[int]) -> str:
    """The tutorial's final scores: mean length of all episodes, and of the 100 longest."""
    if not lengths:
        return "no episode ended"
    best = sorted(lengths, reverse=True)[:100]
    return f"overall score: {np.mean(lengths):.1f} steps, best {len(best)} score: {np.mean(best):.1f} steps"


class TensorBoard(TensorBoardOutputFormat):
    """Stable-Baselines3's event files; those of a resumed training replace events that a killed one wrote later.

    Args:
        folder: Of the event files.
        timesteps: Control steps before this training was resumed, or 0.
        hyperparameters: Plain values by dotted key, for the table of all runs.
    """

    def __init__(self, folder: Path, timesteps: int, hyperparameters: Mapping[str, Any]) -> None:
        self.writer = SummaryWriter(log_dir=str(folder), purge_step=timesteps + 1 if timesteps else None)
        self._is_closed = False
        # The first summary, a list of columns, is left out: TensorBoard would use one run's list for all runs, without
        # the columns of other agents. If there is no list, it collects the columns of all runs.
        _columns, *values = hparams(dict(hyperparameters), {})
        for summary in values:  # `SummaryWriter` has no public method for a single summary
            self.writer._get_file_writer().add_summary(summary)


def flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The leaves of a tree by dotted key, as numbers and text."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            leaves.update(flat(value, f"{name}."))
        elif value is not None:
            leaves[name] = value if isinstance(value, bool | int | float | str) else str(value)
    return leaves
