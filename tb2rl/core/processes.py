"""How processes start that help this one: clean, and without the user's script."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import connection, forkserver, resource_tracker, spawn
from typing import Any

# Imported once, in the server that new processes are forked from.
PRELOADED = ["tb2rl.envs.single", "tb2rl.simulation.bullet.batch", "cloudpickle"]


def process_context() -> Any:
    """How processes start: from a clean server (a plain fork would copy torch's threads), elsewhere than on Linux anew.

    macOS has such a server, too, but its libraries do not bear a fork.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    resource_tracker.ensure_running()  # the server would start it, and that unblocks SIGINT
    with _blocked(signal.SIGINT, signal.SIGHUP):
        forkserver.ensure_running()
    return context


@contextmanager
def _blocked(*numbers: int) -> Iterator[None]:
    """Block these signals in this thread, and for ever in processes that start during the block.

    A terminal sends them to every process, and the one that started the others decides what they mean.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def main_hidden() -> Iterator[None]:
    """Start processes in this thread without the user's script: they would run it again, from its first line.

    Other threads go on as before, and so does the module `__main__`: they may be asking where it comes from.
    """
    before = getattr(_hiding, "main", False)
    _hiding.main = True
    try:
        yield
    finally:
        _hiding.main = before


_hiding = threading.local()
_preparation_data = spawn.get_preparation_data


def _data_without_main(name: str) -> dict[str, Any]:
    """What `multiprocessing` tells a new process of this name; it has no switch for leaving the script out."""
    data = _preparation_data(name)
    return {k: v for k, v in data.items() if not (getattr(_hiding, "main", False) and k.startswith("init_main_from_"))}


spawn.get_preparation_data = _data_without_main


def end_with_parent() -> None:
    """Let this process end when the one that started it does, however that ends: a pool's would wait for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def processors() -> int:
    """How many processors this process may use; the shell's variable TB2RL_PROCESSORS says how many at most."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    said = os.environ.get("TB2RL_PROCESSORS", "")
    return min(there, max(1, int(said))) if said.isdigit() else there
