"""What happens beside a training: evaluations, checkpoints, statistics, stopping. Stable-Baselines3 callbacks all."""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from types import FrameType
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import HParam, Image

from tb2rl.evaluation import Evaluator
from tb2rl.maze import load_maze
from tb2rl.render import draw_paths
from tb2rl.resume import Stateful, capture
from tb2rl.runs import Run

_WINDOW = 100  # episodes in a running mean
_PATHS_DRAWN = 5


class Statistics(BaseCallback):
    """Episode statistics in TensorBoard that Stable-Baselines3 does not know of, and the hyper-parameters."""

    def __init__(self, hyperparameters: Mapping[str, Any]) -> None:
        super().__init__()
        self.hyperparameters = hyperparameters
        self._ended: deque[str] = deque(maxlen=_WINDOW)
        self._distances: deque[float] = deque(maxlen=_WINDOW)
        self.lengths: list[int] = []

    def state(self) -> dict[str, Any]:
        return {"ended": self._ended, "distances": self._distances, "lengths": self.lengths}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._ended.extend(map(str, state["ended"]))
        self._distances.extend(map(float, state["distances"]))
        self.lengths.extend(map(int, state["lengths"]))

    def _on_training_start(self) -> None:
        metrics = {"rollout/ep_rew_mean": 0.0, "rollout/ep_len_mean": 0.0, "rollout/crash_rate": 0.0, "eval/score": 0.0}
        self.logger.record(
            "hparams", HParam(_flat(self.hyperparameters), metrics), exclude=("stdout", "log", "json", "csv")
        )

    def _on_step(self) -> bool:
        ended = np.flatnonzero(self.locals["dones"])
        for i in ended:
            info = self.locals["infos"][i]
            self._ended.append(info["ended"])
            self._distances.append(info["distance"])
            self.lengths.append(info["episode"]["l"])
        if ended.size:
            self.logger.record("rollout/crash_rate", self._ended.count("crash") / len(self._ended))
            self.logger.record("rollout/distance_mean", float(np.mean(self._distances)))
        return True


class Evaluate(BaseCallback):
    """Evaluates the greedy policy now and then, keeps the best one, draws the paths of a few episodes."""

    def __init__(self, run: Run, evaluator: Evaluator, freq: int) -> None:
        super().__init__()
        self.run, self.evaluator, self.freq = run, evaluator, freq
        self._next = freq
        self._best = (-np.inf, -np.inf)
        self._elapsed_before = 0.0

    def state(self) -> dict[str, Any]:
        return {"next": self._next, "best": self._best, "elapsed": self._elapsed()}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._next, self._elapsed_before = int(state["next"]), float(state["elapsed"])
        success, mean_return = map(float, state["best"])
        self._best = (success, mean_return)

    def _elapsed(self) -> float:
        """Seconds since the training began."""
        return round(self._elapsed_before + time.monotonic() - self._started, 3)

    def _on_training_start(self) -> None:
        self._started = time.monotonic()

    def _on_step(self) -> bool:
        if self._next <= self.num_timesteps < self.locals["total_timesteps"]:  # the end has an evaluation of its own
            self._next = (self.num_timesteps // self.freq + 1) * self.freq
            self.evaluate()
        return True

    def evaluate(self) -> None:
        """Evaluate the policy as it is now."""
        started = time.monotonic()
        evaluation = self.evaluator.run(self.model.policy)
        summary = {"timesteps": self.num_timesteps, **evaluation.summary()}
        summary["seconds"] = round(time.monotonic() - started, 3)
        summary["elapsed"] = self._elapsed()
        summary["best"] = evaluation.score > self._best
        if summary["best"]:
            self._best = evaluation.score
            self.run.save(self.model, "best/policy")
        self.run.note("evaluations.jsonl", summary)
        for key in ("crash_free_rate", "success_rate", "mean_distance", "mean_return", "mean_length", "mean_speed"):
            self.logger.record(f"eval/{key}", summary[key])
        self.logger.record("eval/score", evaluation.score[0])
        few = evaluation.episodes[:_PATHS_DRAWN]
        maze = load_maze(evaluation.task.maze)
        picture = draw_paths(
            maze, evaluation.task.placed(maze), [e.path for e in few], [e.ended == "crash" for e in few]
        )
        self.logger.record("eval/paths", Image(picture, "HWC"))
        self.logger.dump(self.num_timesteps)


class Checkpoints(BaseCallback):
    """Saves everything that the rest of the training depends on, now and then, and keeps the last few of these."""

    def __init__(self, run: Run, freq: int, keep: int) -> None:
        super().__init__()
        self.run, self.freq, self.keep = run, freq, keep
        self._next = freq
        self.others: Sequence[Stateful] = ()  # the callbacks that remember, this one among them

    def state(self) -> dict[str, Any]:
        return {"next": self._next}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._next = int(state["next"])

    def _on_rollout_start(self) -> None:
        if self.freq and self.num_timesteps >= self._next:
            self._next = (self.num_timesteps // self.freq + 1) * self.freq
            self.save()

    def save(self) -> None:
        """Save the training as it is now, where a rollout starts or the training ends."""
        self.run.save_training(self.model, capture(self.model, self.others))
        self.run.prune(self.keep)

    def _on_step(self) -> bool:
        return True


class StopAfterEpisodes(BaseCallback):
    """Stops once so many episodes have ended, over all worlds together."""

    def __init__(self, episodes: int) -> None:
        super().__init__()
        self.left = episodes

    def state(self) -> dict[str, Any]:
        return {"left": self.left}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.left = int(state["left"])

    def _on_step(self) -> bool:
        self.left -= int(self.locals["dones"].sum())
        return self.left > 0


class EpisodeLines(BaseCallback):
    """The tutorial's line for each episode."""

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
        alpha = schedule(self.model._current_progress_remaining) if schedule else float("nan")
        numbers = [("alpha", alpha), ("gamma", getattr(self.model, "gamma", None))]
        numbers.append(("epsilon", getattr(self.model, "exploration_rate", None)))
        shown = " - ".join(f"{name}: {value:.4g}" for name, value in numbers if value is not None)
        minutes, seconds = divmod(int(time.monotonic() - self._started), 60)
        return (
            f"EP: {self._episodes} - [{shown}] - Reward: {episode['r']:.0f} - Steps: {episode['l']} - "
            f"Time: {minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
        )


class StopOnInterrupt(BaseCallback):
    """The first Ctrl-C ends the training as if its time were up; a second one stops at once."""

    def __init__(self) -> None:
        super().__init__()
        self.interrupted = False

    def __enter__(self) -> StopOnInterrupt:
        if threading.current_thread() is threading.main_thread():  # elsewhere Python takes no signals
            self._previous = signal.signal(signal.SIGINT, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._previous)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True
        print("\nstopping: this saves the policy; Ctrl-C again stops at once", flush=True)

    def _on_step(self) -> bool:
        return not self.interrupted


def tutorial_scores(lengths: Sequence[int]) -> str:
    """The two numbers that the tutorial ends with: mean length of all episodes, and of the 100 longest."""
    if not lengths:
        return "no episode ended"
    best = sorted(lengths, reverse=True)[:100]
    return f"overall score: {np.mean(lengths):.1f} steps, best {len(best)} score: {np.mean(best):.1f} steps"


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{name}."))
        elif value is not None:
            flat[name] = value if isinstance(value, bool | int | float | str) else str(value)
    return flat
