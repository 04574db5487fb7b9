"""Translates errors of the operating system and of libraries into messages of one line."""

import errno
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, UnwritableError
from tb2rl.runs import LIBRARY_ERRORS, Run, settings_error

DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
_LIBRARIES = {"stable_baselines3", "sb3_contrib", "torch", "numpy"}


@contextmanager
def translate_resource_errors(folder: Path) -> Iterator[None]:
    """Translate the errors of a full disk, a read-only folder and too little memory into an `InputError`."""
    default_hook = threading.excepthook

    def hook(error: threading.ExceptHookArgs) -> None:
        # Disk errors in TensorBoard's thread are not printed, because the logger raises them in the main thread.
        if getattr(error.exc_value, "errno", None) not in DISK_ERRORS:
            default_hook(error)

    threading.excepthook = hook
    try:
        yield
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        raise UnwritableError(f"cannot write into {folder}: {error.strerror}; its last checkpoint is kept") from None
    except MemoryError:
        raise InputError(
            "not enough memory: reduce train.n_envs, task.beams, agent.buffer_size, agent.n_steps, agent.batch_size or "
            "train.eval_episodes"
        ) from None
    finally:
        threading.excepthook = default_hook


@contextmanager
def translate_learning_errors(algorithm: BaseAlgorithm, run: Run) -> Iterator[None]:
    """Translate the errors of diverged weights and of settings that the algorithm rejects into an `InputError`.

    Errors in a task, an environment or a user's own algorithm are bugs, and pass unchanged.
    """
    try:
        yield
    except MemoryError:  # for `translate_resource_errors`
        raise
    except LIBRARY_ERRORS as error:
        if not has_finite_weights(algorithm):
            reason = "the training diverged (its weights are not finite); try a smaller agent.learning_rate"
        elif _arose_in_libraries(error):
            reason = str(settings_error(run.config, f"{type(error).__name__}: {error}"))
        else:
            raise
        raise InputError(f"{run.folder}: {reason}") from error


def has_finite_weights(algorithm: BaseAlgorithm) -> bool:
    return all(bool(th.isfinite(parameter).all()) for parameter in algorithm.policy.parameters())


def _arose_in_libraries(error: BaseException) -> bool:
    """Whether the traceback from `learn` to the error has only modules of `_LIBRARIES`."""
    modules = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    packages = {name.partition(".")[0] for name in modules[2:]}  # the first two are this module and `training.py`
    return bool(packages) and packages <= _LIBRARIES
