"""A pool of Python threads for compiled functions that release the interpreter lock (`nogil`).

Idle threads sleep. OpenMP's threads are no alternative: they spin while they wait, which slows down a busy machine, and
a process that is forked after they have run crashes.
"""

import os
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numba

# Number of threads: the environment variable NUMBA_NUM_THREADS, or by default the processors of this process.
THREADS: int = numba.config.NUMBA_NUM_THREADS
MIN_PARALLEL_TIME = 0.25e-3  # [s] shorter work runs in one thread, because waking the others costs 0.1 ms or more
_THREAD_DELAY = 0.06e-3  # [s] from handing work to a sleeping thread until the thread starts


def parallel_if_long(work: Callable[..., Any], count: int, item_time: float, *arguments: Any) -> None:
    """Do the work on `count` items as `parallel_for` does, or in the calling thread alone if it is short.

    Args:
        work: Function that does the items from `first` to `end` - 1, called as `work(first, end, *arguments)`.
        count: Number of items, such as robots.
        item_time: Estimated duration of an item in one thread [s].
        arguments: Other arguments of `work`.
    """
    if count * item_time > MIN_PARALLEL_TIME:
        head_start = int(_THREAD_DELAY / item_time)  # items that this thread does while the others wake up
        parallel_for(work, count, head_start, *arguments)
    else:
        work(0, count, *arguments)


def parallel_for(work: Callable[..., Any], count: int, lead: int, *arguments: Any) -> None:
    """Divide the range from 0 to `count` among all threads, call `work(first, end, *arguments)` in each, and wait.

    The part of the calling thread is longer by `lead`, because this thread starts while the others wake up.
    """
    own_end = min(count, (count + lead * (THREADS - 1)) // THREADS)
    borders = [own_end + (count - own_end) * i // max(THREADS - 1, 1) for i in range(THREADS)]
    other_parts = list(pairwise(borders))
    results: SimpleQueue[BaseException | None] = SimpleQueue()
    for part in other_parts:
        _tasks().put((work, (*part, *arguments), results))
    try:
        work(0, own_end, *arguments)
    finally:
        errors = [results.get() for _ in other_parts]
    for error in filter(None, errors):
        raise error


@cache
def _tasks() -> SimpleQueue[Any]:
    """Start the other threads and return their task queue, which is three times as fast as `concurrent.futures`."""
    tasks: SimpleQueue[Any] = SimpleQueue()
    for _ in range(THREADS - 1):
        Thread(target=_run_tasks, args=(tasks,), daemon=True).start()
    return tasks


def _run_tasks(tasks: SimpleQueue[Any]) -> None:
    while True:
        work, arguments, results = tasks.get()
        try:
            work(*arguments)
            results.put(None)
        except BaseException as error:  # the caller raises it again
            results.put(error)
        del work, arguments, results  # so that an idle thread keeps no arrays alive


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_tasks.cache_clear)  # a forked process has no copy of the threads
