"""Stable-Baselines3 callbacks of a training: evaluations, checkpoints, early stops, and the list of all."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import Image

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.runs.folder import Run
from tb2rl.runs.normalisation import driving_policy
from tb2rl.training.diagnostics import TrainingDiagnostics
from tb2rl.training.state import StatefulCallback, capture
from tb2rl.training.statistics import EpisodeLines, EpisodeStatistics
from tb2rl.viz.pictures import draw_paths

_PATHS_DRAWN = 5


class EvaluationCallback(StatefulCallback):
    """Evaluates the greedy policy periodically, keeps the best one, and stops the training once it is good enough.

    Args:
        run: Gets the best policy, and a line for each evaluation. Its settings say when to evaluate and to stop.
        evaluator: See `make_evaluator`.
        on_evaluation: Called with each evaluation; an exception from it ends the training.

    Attributes:
        stopped: Whether it stopped the training.
    """

    saved = ("_next", "_reached", "stopped", "_best", "_elapsed")

    def __init__(self, run: Run, evaluator: Any, on_evaluation: Callable[[Evaluation], object] | None = None) -> None:
        super().__init__()
        self.run, self.evaluator, self._on_evaluation = run, evaluator, on_evaluation
        self.settings = run.config.train
        self.stopped = False
        self._reached = 0  # evaluations in a row that reached the score to stop at
        self._next = self.settings.eval_freq
        self._best = (-sys.float_info.max, -sys.float_info.max)
        self._elapsed = 0.0  # [s] since the training began
        self._clock = time.monotonic()

    def state(self) -> dict[str, Any]:
        self._count_seconds()
        return super().state()

    def restart(self) -> None:
        """Count anew, if it stopped a training that is to continue."""
        self.stopped, self._reached = False, 0

    def _on_training_start(self) -> None:
        self._clock = time.monotonic()

    def _count_seconds(self) -> float:
        before, self._clock = self._clock, time.monotonic()
        self._elapsed = round(self._elapsed + self._clock - before, 3)
        return self._elapsed

    def _on_step(self) -> bool:
        if self._next <= self.num_timesteps < self.locals["total_timesteps"]:  # the final policy is evaluated apart
            freq, enough = self.settings.eval_freq, self.settings.stop_score
            self._next = (self.num_timesteps // freq + 1) * freq
            rate = self.evaluate().good_rate
            self._reached = self._reached + 1 if enough is not None and rate >= enough else 0
            self.stopped = self._reached >= self.settings.stop_evaluations
        return not self.stopped

    def evaluate(self, progress_bar: bool = False) -> Evaluation:
        """Evaluate the present policy."""
        started = time.monotonic()
        evaluation = self.evaluator.run(driving_policy(self.model), progress_bar)
        score = evaluation.score if self.settings.best_by == "success" else (evaluation.score[1], 0.0)
        summary = {
            "timesteps": self.num_timesteps,
            **evaluation.summary(),
            "seconds": round(time.monotonic() - started, 3),
            "elapsed": self._count_seconds(),
            "best": score > self._best,
        }
        if summary["best"]:
            self._best = score
            self.run.save(self.model, "best/policy")
        self.run.append_evaluation(summary)
        self._log(evaluation, summary)
        if self._on_evaluation:
            self._on_evaluation(evaluation)
        return evaluation

    def _log(self, evaluation: Evaluation, summary: Mapping[str, Any]) -> None:
        """Write an evaluation to the logger's outputs, such as TensorBoard."""
        for metric in shown_metrics(goal_task=True):
            self.logger.record(f"eval/{metric.key}", summary[metric.key])
        self.logger.record("eval/score", evaluation.score[0])
        picture = draw_paths(evaluation.scene, evaluation.episodes[:_PATHS_DRAWN])
        self.logger.record("eval/paths", Image(picture, "HWC"))
        self.logger.dump(self.num_timesteps)


class Checkpoints(StatefulCallback):
    """Saves the state of the training periodically.

    Attributes:
        stateful: All callbacks with a state, this one among them.
    """

    saved = ("_next",)

    def __init__(self, run: Run) -> None:
        super().__init__()
        self.run, self.freq, self.keep = run, run.config.train.save_freq, run.config.train.keep
        self._next = self.freq
        self.stateful: Sequence[StatefulCallback] = ()

    def _on_rollout_start(self) -> None:
        if self.freq and self.num_timesteps >= self._next:
            self._next = (self.num_timesteps // self.freq + 1) * self.freq
            self.save(in_rollout=True)

    def save(self, in_rollout: bool = False) -> None:
        """Save the present state, where a rollout starts (`in_rollout`) or the training ends."""
        self.run.save_training(self.model, capture(self.model, self.stateful, in_rollout))
        self.run.prune(self.keep)


class StopAfterEpisodes(StatefulCallback):
    """Stops after a number of episodes, over all environments together."""

    saved = ("left",)

    def __init__(self, episodes: int) -> None:
        super().__init__()
        self.left = episodes

    def _on_step(self) -> bool:
        self.left -= int(self.locals["dones"].sum())
        return self.left > 0


class StopOnSignal(BaseCallback):
    """Ends the training at Ctrl-C, SIGTERM or SIGHUP, where the next rollout starts; a second signal ends it at once.

    Args:
        save: Saves a checkpoint there, so that a resumed training equals the undisturbed one.

    Attributes:
        received: The number of the signal; 0: none.
        stopped: Whether it stopped the training.
    """

    def __init__(self, save: Callable[[], object]) -> None:
        super().__init__()
        self.save, self.received, self.stopped = save, 0, False

    def receive(self, number: int) -> None:
        """Handle a signal; see `ending_signals`.

        Raises:
            KeyboardInterrupt: At the second one.
        """
        if self.received:
            raise KeyboardInterrupt
        self.received = number
        with suppress(OSError, RuntimeError):  # stdout is closed, or the signal interrupts another print
            print("\nstopping after this rollout: this saves the policy, and a checkpoint for --resume; ", end="")
            print("Ctrl-C again stops at once", flush=True)

    def _on_rollout_start(self) -> None:
        if self.received:
            self.save()
            self.stopped = True

    def _on_step(self) -> bool:
        return not self.stopped


class TrainingCallbacks(CallbackList):
    """All callbacks of a training; without an `evaluator` there are no evaluations.

    Attributes:
        stateful: Those whose state belongs to a checkpoint, in its order.
    """

    def __init__(
        self, run: Run, evaluator: Any, on_evaluation: Callable[[Evaluation], object] | None, verbose: int
    ) -> None:
        scene, settings = run.config.scene, run.config.train
        period, max_speed = scene.task.control_period, scene.actions.max_speed
        self.statistics, self.checkpoints = EpisodeStatistics(), Checkpoints(run)
        self.evaluation = EvaluationCallback(run, evaluator, on_evaluation) if evaluator else None
        self.stop = StopOnSignal(partial(self.checkpoints.save, in_rollout=True))
        self.stateful: list[StatefulCallback] = [
            self.statistics,
            self.checkpoints,
            TrainingDiagnostics(settings.total_timesteps, period, max_speed),
            *([self.evaluation] if self.evaluation else []),
            *([StopAfterEpisodes(settings.episodes)] if settings.episodes else []),
        ]
        self.checkpoints.stateful = self.stateful
        super().__init__([*self.stateful, self.stop, *([EpisodeLines()] if verbose else [])])
