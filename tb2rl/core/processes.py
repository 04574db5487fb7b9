"""Starts worker processes from a fork server, without the user's script."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from multiprocessing import connection, forkserver, resource_tracker, spawn
from typing import Any

# Modules that the fork server imports once for all workers.
PRELOADED = ["tb2rl.evaluation.evaluate", "tb2rl.simulation.bullet.batch", "cloudpickle"]
# Environment variables that limit a worker and its children to one thread each, because workers run in parallel.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "TB2RL_PROCESSORS": "1"}


def process_context() -> Any:
    """The context of `multiprocessing`: the fork server on Linux, elsewhere "spawn".

    A plain fork does not work with torch's threads. The fork server of macOS does not work with its system libraries.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    resource_tracker.ensure_running()  # before the signals are blocked, because its start unblocks SIGINT
    # A terminal sends these signals to all processes. The server blocks them, because its parent handles them.
    old_mask, environment = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP}), dict(os.environ)
    os.environ.update(ONE_THREAD)
    try:
        forkserver.ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(environment)
        signal.pthread_sigmask(signal.SIG_SETMASK, old_mask)
    return context


@contextmanager
def hide_main_script() -> Iterator[None]:
    """During the block, processes that this thread starts do not import the user's script.

    A script without `if __name__ == "__main__"` would run again in each. Processes that other threads start import it.
    """
    token = _is_main_hidden.set(True)
    try:
        yield
    finally:
        _is_main_hidden.reset(token)


_is_main_hidden = ContextVar("_is_main_hidden", default=False)
_original_preparation_data = spawn.get_preparation_data


def _preparation_data(name: str) -> dict[str, Any]:
    """Preparation data of a new process, without the parent's `__main__` while `hide_main_script` is active."""
    items = _original_preparation_data(name).items()
    return {key: value for key, value in items if not (_is_main_hidden.get() and key.startswith("init_main_from_"))}


# `multiprocessing` has no option to exclude the script. The only other way, changing the module `__main__` temporarily,
# would affect the user's other threads.
spawn.get_preparation_data = _preparation_data


def end_with_parent() -> None:
    """End this process when its parent ends, even if the parent is killed. Otherwise a worker would wait forever."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def processors() -> int:
    """Number of processors for this process; the environment variable TB2RL_PROCESSORS is an upper limit."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("TB2RL_PROCESSORS", "")
    return min(available, max(1, int(limit))) if limit.isdigit() else available
