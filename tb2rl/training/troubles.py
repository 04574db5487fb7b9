"""What stops a training from outside of our code, said in one line."""

from __future__ import annotations

import errno
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, UnwritableError
from tb2rl.runs.algorithm import refusal
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.folder import Run

DISK_TROUBLES = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
_WRITER = "_AsyncWriterThread"  # of tensorboard.summary.writer.event_file_writer
_LIBRARIES = {"stable_baselines3", "sb3_contrib", "torch", "numpy"}


@contextmanager
def machine_troubles_named(folder: Path) -> Iterator[None]:
    """Say in one line that the disk is full, the folder cannot be written any more, or the memory is too small.

    Raises:
        InputError: If that is so.
    """
    try:
        with _writers_quiet():
            yield
    except OSError as error:
        if error.errno not in DISK_TROUBLES:
            raise
        raise UnwritableError(f"cannot write into {folder}: {error.strerror}; its last checkpoint stands") from None
    except MemoryError:
        raise InputError(
            "not enough memory: take fewer train.n_envs or task.beams, or a smaller agent.buffer_size, n_steps, "
            "batch_size or train.eval_episodes"
        ) from None


@contextmanager
def _writers_quiet() -> Iterator[None]:
    """Print no traceback of TensorBoard's writing thread for such an error, because the logger raises it again."""
    usual = threading.excepthook

    def show(error: threading.ExceptHookArgs) -> None:
        named = isinstance(error.exc_value, OSError) and error.exc_value.errno in DISK_TROUBLES
        if not (named and type(error.thread).__name__ == _WRITER):
            usual(error)

    threading.excepthook = show
    try:
        yield
    finally:
        threading.excepthook = usual


@contextmanager
def learning_troubles_named(algorithm: BaseAlgorithm, run: Run) -> Iterator[None]:
    """Say in one line that the weights are not numbers any more, or that the algorithm fails with its settings.

    An error of the task, of the environment or of a user's own algorithm is a bug, and keeps its traceback.

    Args:
        algorithm: What learns during the block.
        run: Its run.

    Raises:
        InputError: If that is so.
    """
    try:
        yield
    except MemoryError:
        raise
    except LIBRARY_ERRORS as error:
        if not all(bool(th.isfinite(parameter).all()) for parameter in algorithm.policy.parameters()):
            reason = "the training diverged (its weights are not finite); try a smaller agent.learning_rate"
        elif _arose_in_libraries(error):
            reason = str(refusal(run.config, f"{type(error).__name__}: {error}"))
        else:
            raise
        raise InputError(f"{run.folder}: {reason}") from error


def _arose_in_libraries(error: BaseException) -> bool:
    """Whether nothing of ours or of the user's was called between `learn` and the error."""
    modules = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    called = [name.partition(".")[0] for name in modules[2:]]  # the first two are this module and the training
    return bool(called) and set(called) <= _LIBRARIES
