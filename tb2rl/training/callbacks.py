"""What happens beside a training: evaluations, checkpoints, stopping. Stable-Baselines3 callbacks all."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Image

from tb2rl.core.signals import ending_signals
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.evaluator import Evaluator
from tb2rl.runs.config import TrainSettings
from tb2rl.runs.folder import Run
from tb2rl.runs.normalisation import driving_policy
from tb2rl.training.state import Stateful, capture
from tb2rl.viz.pictures import draw_paths

_PATHS_DRAWN = 5
_LOGGED = (
    "failure_free_rate", "success_rate", "mean_distance", "mean_return", "mean_length", "mean_speed", "median_squares",
)  # fmt: skip


class Evaluate(BaseCallback):
    """Evaluates the greedy policy now and then, keeps the best one, stops the training once it is good enough.

    Args:
        run: Gets the best policy, and a line for each evaluation.
        evaluator: Drives the episodes.
        settings: How often, what makes one the best, and when one is good enough.
        evaluated: Is told of each one when it is noted; what it raises ends the training.

    Attributes:
        stopped: Whether it stopped the training.
    """

    def __init__(
        self,
        run: Run,
        evaluator: Evaluator,
        settings: TrainSettings,
        evaluated: Callable[[Evaluation], object] | None = None,
    ) -> None:
        super().__init__()
        self.run, self.evaluator, self.settings, self._evaluated = run, evaluator, settings, evaluated
        self.stopped = False
        self._reached = 0  # evaluations in a row
        self._next = settings.eval_freq
        self._best = (-np.inf, -np.inf)
        self._elapsed_before = 0.0

    def state(self) -> dict[str, Any]:
        counts = {"next": self._next, "reached": self._reached, "stopped": self.stopped}
        return {**counts, "best": self._best, "elapsed": self._elapsed()}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._next, self._elapsed_before = int(state["next"]), float(state["elapsed"])
        self._reached, self.stopped = int(state["reached"]), bool(state["stopped"])
        success, mean_return = map(float, state["best"])
        self._best = (success, mean_return)

    def go_on(self) -> None:
        """Count anew, after it has stopped the training and more steps are asked."""
        self.stopped, self._reached = False, 0

    def _elapsed(self) -> float:
        """Seconds since the training began."""
        return round(self._elapsed_before + time.monotonic() - self._started, 3)

    def _on_training_start(self) -> None:
        self._started = time.monotonic()

    def _on_step(self) -> bool:
        if self._next <= self.num_timesteps < self.locals["total_timesteps"]:  # the end has an evaluation of its own
            freq, enough = self.settings.eval_freq, self.settings.stop_score
            self._next = (self.num_timesteps // freq + 1) * freq
            rate = self.evaluate().good_rate
            self._reached = self._reached + 1 if enough is not None and rate >= enough else 0
            self.stopped = self._reached >= self.settings.stop_evaluations
        return not self.stopped

    def evaluate(self, progress: bool = False) -> Evaluation:
        """Evaluate the policy as it is now; with `progress`, a bar on a terminal says how far this is."""
        started = time.monotonic()
        evaluation = self.evaluator.run(driving_policy(self.model), progress)
        summary = {"timesteps": self.num_timesteps, **evaluation.summary()}
        summary["seconds"] = round(time.monotonic() - started, 3)
        summary["elapsed"] = self._elapsed()
        score = evaluation.score if self.settings.best_by == "success" else (evaluation.score[1], 0.0)
        summary["best"] = score > self._best
        if summary["best"]:
            self._best = score
            self.run.save(self.model, "best/policy")
        self.run.note_evaluation(summary)
        for key in _LOGGED:
            self.logger.record(f"eval/{key}", summary[key])
        self.logger.record("eval/score", evaluation.score[0])
        picture = draw_paths(evaluation.scene, evaluation.episodes[:_PATHS_DRAWN])
        self.logger.record("eval/paths", Image(picture, "HWC"))
        self.logger.dump(self.num_timesteps)
        if self._evaluated:
            self._evaluated(evaluation)
        return evaluation


class Checkpoints(BaseCallback):
    """Saves everything that the rest of the training depends on, now and then, and keeps the last few of these.

    Args:
        run: Gets the checkpoints.
        freq: Control steps between checkpoints; 0: only the last.
        keep: How many stay.

    Attributes:
        others: The callbacks that remember, this one among them.
    """

    def __init__(self, run: Run, freq: int, keep: int) -> None:
        super().__init__()
        self.run, self.freq, self.keep = run, freq, keep
        self._next = freq
        self.others: Sequence[Stateful] = ()

    def state(self) -> dict[str, Any]:
        return {"next": self._next}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._next = int(state["next"])

    def _on_rollout_start(self) -> None:
        if self.freq and self.num_timesteps >= self._next:
            self._next = (self.num_timesteps // self.freq + 1) * self.freq
            self.save(in_rollout=True)

    def save(self, in_rollout: bool = False) -> None:
        """Save the training as it is now, where a rollout starts (`in_rollout`) or the training ends."""
        self.run.save_training(self.model, capture(self.model, self.others, in_rollout))
        self.run.prune(self.keep)

    def _on_step(self) -> bool:
        return True


class StopAfterEpisodes(BaseCallback):
    """Stops once so many episodes have ended, over all environments together."""

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


class StopOnInterrupt(BaseCallback):
    """Ends the training at Ctrl-C, SIGTERM or SIGHUP, where the next rollout starts; a second one stops at once.

    Args:
        save: Saves a checkpoint where a rollout starts, so that a resumed training is the undisturbed one.

    Attributes:
        interrupted: The number of the signal that came; 0: none.
        stopped: Whether the training was stopped before its time was up.
    """

    def __init__(self, save: Callable[[], object]) -> None:
        super().__init__()
        self.save, self.interrupted, self.stopped = save, 0, False
        self._handled = ExitStack()

    def __enter__(self) -> StopOnInterrupt:
        self._handled.enter_context(ending_signals(self._on_signal))
        return self

    def __exit__(self, *_: object) -> None:
        self._handled.close()

    def _on_signal(self, number: int) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = number
        with suppress(OSError, RuntimeError):  # nobody reads it, or it comes in the middle of another line
            print("\nstopping after this rollout: this saves the policy, and a checkpoint for --resume; ", end="")
            print("Ctrl-C again stops at once", flush=True)

    def _on_rollout_start(self) -> None:
        if self.interrupted:
            self.save()
            self.stopped = True

    def _on_step(self) -> bool:
        return not self.stopped
