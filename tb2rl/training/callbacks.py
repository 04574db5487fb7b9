"""Callbacks of a training for Stable-Baselines3: evaluations, checkpoints, and the list of all callbacks."""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.logger import Image

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.metrics import shown_metrics
from tb2rl.runs import Run, policy_with_normalization
from tb2rl.training.state import StatefulCallback, capture
from tb2rl.training.statistics import EpisodeStatistics, TrainingDiagnostics
from tb2rl.viz.pictures import draw_paths

_NUM_DRAWN_PATHS = 5  # number of episodes in the picture eval/paths


class EvaluationCallback(StatefulCallback):
    """Evaluates the greedy policy periodically, saves the best policy, and stops the training at `train.stop_score`.

    Args:
        run: Run folder for the best policy and the results.
        evaluator: Evaluator of policies, from `make_evaluator`.
        diagnostics: Warns if the evaluated robot spins; such a score does not stop the training.
        on_evaluation: Callback that gets each evaluation; its exceptions end the training.

    Attributes:
        stopped_training: Whether this callback stopped the training.
    """

    saved_attributes = ("_next", "_reached", "stopped_training", "_best", "_elapsed")

    def __init__(
        self,
        run: Run,
        evaluator: Any,
        diagnostics: TrainingDiagnostics,
        on_evaluation: Callable[[Evaluation], object] | None = None,
    ) -> None:
        super().__init__()
        self.run, self.evaluator, self._on_evaluation = run, evaluator, on_evaluation
        self._diagnostics = diagnostics
        self.settings = run.config.train
        self.clear_early_stop()
        self._next = self.settings.eval_freq  # timesteps of the next evaluation
        self._best = (-sys.float_info.max, -sys.float_info.max)  # score of the best evaluation
        self._elapsed = 0.0  # the setter starts the clock

    def clear_early_stop(self) -> None:
        """Reset `stopped_training`, and the number of evaluations that reached `train.stop_score`."""
        self.stopped_training, self._reached = False, 0  # consecutive evaluations that reached `train.stop_score`

    @property
    def _elapsed(self) -> float:
        """Wall-clock time of the training [s], including the time before it was resumed."""
        return round(time.monotonic() - self._start_time, 3)

    @_elapsed.setter
    def _elapsed(self, seconds: float) -> None:
        self._start_time = time.monotonic() - seconds

    def _on_step(self) -> bool:
        # After the last step, `_Learner.learn` evaluates the final policy.
        if self._next <= self.num_timesteps < self.locals["total_timesteps"]:
            freq, stop_score = self.settings.eval_freq, self.settings.stop_score
            self._next = (self.num_timesteps // freq + 1) * freq
            evaluation = self.evaluate()
            is_reached = stop_score is not None and evaluation.good_rate >= stop_score and not evaluation.spins
            self._reached = self._reached + 1 if is_reached else 0
            self.stopped_training = self._reached >= self.settings.stop_evaluations
        return not self.stopped_training

    def evaluate(self, progress_bar: bool = False) -> Evaluation:
        """Evaluate the present policy; save it if it is the best so far, and store and log the result."""
        start_time = time.monotonic()
        evaluation = self.evaluator.run(policy_with_normalization(self.model), progress_bar)
        success_rate, mean_return = evaluation.score  # the rate is rounded to half percents
        score = (success_rate, mean_return) if self.settings.best_by == "success" else (mean_return, 0.0)
        summary = {
            "timesteps": self.num_timesteps,
            **evaluation.summary(),
            "seconds": round(time.monotonic() - start_time, 3),
            "elapsed": self._elapsed,
            "best": score > self._best,
        }
        if summary["best"]:
            self._best = score
            self.run.save(self.model, "best/policy")
        self.run.append_training_evaluation(summary)
        for metric in shown_metrics(goal_task=True, has_filters=True):  # all of them
            self.logger.record(f"eval/{metric.key}", summary[metric.key])
        self.logger.record("eval/score", success_rate)
        self.logger.record("eval/spins", float(evaluation.spins))
        picture = draw_paths(evaluation.scene, evaluation.episodes[:_NUM_DRAWN_PATHS])
        self.logger.record("eval/paths", Image(picture, "HWC"))
        self.logger.dump(self.num_timesteps)
        if evaluation.spins and self.num_timesteps >= self.settings.total_timesteps / 2:
            self._diagnostics.warn("spinning")
        if self._on_evaluation:
            self._on_evaluation(evaluation)
        return evaluation


class CheckpointCallback(StatefulCallback):
    """Saves checkpoints periodically, and when a signal interrupts the training.

    Ctrl-C, SIGTERM or SIGHUP stop the training at the start of the next rollout, so that it can be resumed exactly. A
    second signal stops it at once.

    Attributes:
        callbacks: The callbacks of the training.
        signal_number: Signal that interrupted the training; 0: none.
        stopped_training: Whether this callback stopped the training.
    """

    saved_attributes = ("_next",)
    callbacks: CallbackList

    def __init__(self, run: Run) -> None:
        super().__init__()
        self.run, self.freq = run, run.config.train.save_freq
        self._next = self.freq
        self.signal_number, self.stopped_training = 0, False

    def handle_signal(self, number: int) -> None:
        """Handle a termination signal; raises a `KeyboardInterrupt` at the second signal."""
        if self.signal_number:
            raise KeyboardInterrupt
        self.signal_number = number
        with suppress(OSError, RuntimeError):  # stdout is closed, or the signal interrupts another print
            print("\ntraining stops after this rollout, then saves the policy and a checkpoint for --resume; ", end="")
            print("Ctrl-C again stops at once", flush=True)

    def _on_rollout_start(self) -> None:
        self.stopped_training = bool(self.signal_number)
        is_due = self.freq and self.num_timesteps >= self._next
        if is_due:
            self._next = (self.num_timesteps // self.freq + 1) * self.freq
        if is_due or self.stopped_training:
            self.save(at_rollout_start=True)

    def _on_step(self) -> bool:
        return not self.stopped_training

    def save(self, at_rollout_start: bool = False) -> None:
        """Save a checkpoint at the start of a rollout (`at_rollout_start`), or at the end of the training."""
        self.run.save_training(self.model, capture(self.model, self.callbacks, at_rollout_start))


class TrainingCallbacks(CallbackList):
    """All callbacks of a training; without an `evaluator` there are no evaluations."""

    def __init__(
        self, run: Run, evaluator: Any, on_evaluation: Callable[[Evaluation], object] | None, verbose: int
    ) -> None:
        self.statistics = EpisodeStatistics(run.config.train.episodes, verbose)
        self.checkpoint = CheckpointCallback(run)
        diagnostics = TrainingDiagnostics(run.config, self.statistics)
        self.evaluation = EvaluationCallback(run, evaluator, diagnostics, on_evaluation) if evaluator else None
        callbacks = [self.statistics, self.checkpoint, diagnostics]
        super().__init__([*callbacks, self.evaluation] if self.evaluation else [*callbacks])
        self.checkpoint.callbacks = self
