"""A pool of threads for compiled work, which sleep while there is none.

OpenMP's threads spin while they wait, which slows everything on a busy machine unless a variable prevents it before any
library loads OpenMP, and a process that is forked after they have run dies in them. Python's threads have neither
fault, as long as the work releases the interpreter (`nogil`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numba

# One for each processor that this process may use, or as many as the shell's variable of this name says.
THREADS: int = numba.config.NUMBA_NUM_THREADS


def parallel_for(work: Callable[..., Any], count: int, lead: int, *arguments: Any) -> None:
    """Call `work(first, last, *arguments)` for parts of the range from 0 to `count`, one for each thread, and wait.

    The part of the calling thread is larger by `lead`, because it begins before the others are awake.
    """
    first = min(count, (count + lead * (THREADS - 1)) // THREADS)
    borders = [first + (count - first) * number // max(THREADS - 1, 1) for number in range(THREADS)]
    others = list(pairwise(borders))
    done: SimpleQueue[BaseException | None] = SimpleQueue()
    for part in others:
        _tasks().put((work, (*part, *arguments), done))
    try:
        work(0, first, *arguments)
    finally:
        errors = [done.get() for _ in others]
    for error in filter(None, errors):
        raise error


@cache
def _tasks() -> SimpleQueue[Any]:
    """The queue of work; `concurrent.futures` takes three times as long to hand it over."""
    tasks: SimpleQueue[Any] = SimpleQueue()
    for _ in range(THREADS - 1):
        Thread(target=_serve, args=(tasks,), daemon=True).start()
    return tasks


def _serve(tasks: SimpleQueue[Any]) -> None:
    while True:
        work, arguments, done = tasks.get()
        try:
            work(*arguments)
            done.put(None)
        except BaseException as error:  # the caller raises it again
            done.put(error)
        del work, arguments, done  # keeps nothing alive until the next work


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_tasks.cache_clear)  # threads stay behind in the parent
