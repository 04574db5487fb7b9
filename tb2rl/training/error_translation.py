"""Translates errors of the machine and of libraries into one line."""

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
from tb2rl.runs.algorithm import settings_error
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.folder import Run

DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
_WRITER = "_AsyncWriterThread"  # of tensorboard.summary.writer.event_file_writer; nothing public tells it from others
_LIBRARIES = {"stable_baselines3", "sb3_contrib", "torch", "numpy"}


@contextmanager
def translate_machine_errors(folder: Path) -> Iterator[None]:
    """Translate the errors of a full disk, a read-only folder and too little memory into an `InputError`."""
    try:
        with _quiet_writer_thread():
            yield
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        raise UnwritableError(f"cannot write into {folder}: {error.strerror}; its last checkpoint stands") from None
    except MemoryError:
        raise InputError(
            "not enough memory: take fewer train.n_envs or task.beams, or a smaller agent.buffer_size, n_steps, "
            "batch_size or train.eval_episodes"
        ) from None


@contextmanager
def _quiet_writer_thread() -> Iterator[None]:
    """Silence TensorBoard's writer thread at a disk error, because the logger raises it again."""
    default = threading.excepthook

    def show(error: threading.ExceptHookArgs) -> None:
        on_disk = isinstance(error.exc_value, OSError) and error.exc_value.errno in DISK_ERRORS
        if not (on_disk and type(error.thread).__name__ == _WRITER):
            default(error)

    threading.excepthook = show
    try:
        yield
    finally:
        threading.excepthook = default


@contextmanager
def translate_learning_errors(algorithm: BaseAlgorithm, run: Run) -> Iterator[None]:
    """Translate the errors of diverged weights, and of settings that the algorithm refuses, into an `InputError`.

    An error in a task, an environment or a user's own algorithm is a bug, and keeps its traceback.
    """
    try:
        yield
    except MemoryError:
        raise
    except LIBRARY_ERRORS as error:
        if not all(bool(th.isfinite(parameter).all()) for parameter in algorithm.policy.parameters()):
            reason = "the training diverged (its weights are not finite); try a smaller agent.learning_rate"
        elif _arose_in_libraries(error):
            reason = str(settings_error(run.config, f"{type(error).__name__}: {error}"))
        else:
            raise
        raise InputError(f"{run.folder}: {reason}") from error


def _arose_in_libraries(error: BaseException) -> bool:
    """Whether no code of ours or of the user was called between `learn` and the error."""
    modules = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    called = {name.partition(".")[0] for name in modules[2:]}  # the first two are this module and the trainer
    return bool(called) and called <= _LIBRARIES
