"""Start of worker processes: from a clean server, without the user's script."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import connection, forkserver, resource_tracker, spawn
from typing import Any

# Imported once, by the fork server.
PRELOADED = ["tb2rl.envs.turtlebot2_env", "tb2rl.simulation.bullet.batch", "cloudpickle"]
# A helping process and its children use one thread each, because others run beside it.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "TB2RL_PROCESSORS": "1"}


def process_context() -> Any:
    """The fork server of `multiprocessing` on Linux (a plain fork would copy torch's threads), elsewhere "spawn".

    macOS has a fork server, too, but its libraries do not survive a fork.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    resource_tracker.ensure_running()  # the server would start it, and that unblocks SIGINT
    with _blocked(signal.SIGINT, signal.SIGHUP), _environment(ONE_THREAD):
        forkserver.ensure_running()
    return context


@contextmanager
def _blocked(*numbers: int) -> Iterator[None]:
    """Block signals in this thread, and permanently in processes that start during the block.

    A terminal sends them to every process; the parent decides what they mean.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables of processes that start during the block."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def main_hidden() -> Iterator[None]:
    """Start processes in this thread without the user's script, because a script without a guard would run again.

    Other threads and the module `__main__` itself are unaffected.
    """
    before = getattr(_hidden, "main", False)
    _hidden.main = True
    try:
        yield
    finally:
        _hidden.main = before


_hidden = threading.local()
_preparation_data = spawn.get_preparation_data


def _data_without_main(name: str) -> dict[str, Any]:
    """Preparation data of a new process without the parent's `__main__` while `main_hidden` is active."""
    data = _preparation_data(name)
    return {k: v for k, v in data.items() if not (getattr(_hidden, "main", False) and k.startswith("init_main_from_"))}


# Every start method calls this function and none has an option to leave the script out; changing `__main__` instead,
# the only other way, would be seen by the user's other threads.
spawn.get_preparation_data = _data_without_main


def end_with_parent() -> None:
    """End this process when its parent ends in whatever way, because a pool's process would wait forever."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def processors() -> int:
    """Number of processors that this process may use, at most the environment variable TB2RL_PROCESSORS."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("TB2RL_PROCESSORS", "")
    return min(available, max(1, int(limit))) if limit.isdigit() else available
