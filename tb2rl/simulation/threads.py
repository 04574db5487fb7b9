"""Compiled work shared out among threads of this process, which sleep while there is none.

OpenMP's threads spin while they wait, which slows everything on a busy machine unless it is told otherwise before any
library loads it, and a process that is forked after they have run dies in them. A pool of Python's has neither fault,
and costs no more, as long as the work lets go of the interpreter (`nogil`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

import numba

# As many as this process may use processors, or as the shell's variable of this name says.
THREADS: int = numba.config.NUMBA_NUM_THREADS


def share_out(work: Callable[..., Any], count: int, *arguments: Any) -> None:
    """Call `work(first, last, *arguments)` for parts of the range from 0 to `count`, one for each thread, and wait."""
    mine, *theirs = pairwise(count * number // THREADS for number in range(THREADS + 1))
    waiting = [_pool().submit(work, *part, *arguments) for part in theirs]
    work(*mine, *arguments)
    for other in waiting:
        other.result()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS - 1, "tb2rl")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads stay behind in the parent
