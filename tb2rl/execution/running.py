"""Running jobs: as many at once as there are places, each tried again where its worker dies, one table of all."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import closing
from typing import Any, Protocol

from tb2rl.core.errors import InputError
from tb2rl.execution.job import Job, Outcome
from tb2rl.execution.table import LiveTable
from tb2rl.execution.where import Where

_LOOK = 0.5  # [s] between looks at how many places there are


class Workers(Protocol):
    """What does jobs: processes of this machine (`local.py`), or Ray (`cluster.py`)."""

    @property
    def places(self) -> int:
        """How many jobs can run at once, now."""

    def start(self, job: Job) -> None:
        """Begin a job; there is a free place."""

    def wait(self, seconds: float) -> list[tuple[Job, Outcome]]:
        """The jobs that ended meanwhile; returns when there are some, or after so many seconds."""

    def close(self) -> None:
        """End what still runs."""


def run_jobs(
    jobs: Iterable[Job], where: Where, shared: Any = None, seconds: float | None = None
) -> Iterator[tuple[Job, Any]]:
    """Do jobs, and give each with what its function returned as it ends; its folder is there by then.

    However this ends, by Ctrl-C or an error of a job, what still runs ends with it. What is done stays.

    Args:
        jobs: Taken one by one as places become free.
        where: What does them.
        shared: What all jobs share, large perhaps: it is sent once to each worker, and given to each function.
        seconds: Time for it, after which what still runs is ended; None: as much as it takes.

    Raises:
        InputError: If a job raised one, its workers died too often, or there is nothing to do it.
        RuntimeError: If a job raised anything else; the message has its traceback.
    """
    deadline = math.inf if seconds is None else time.monotonic() + seconds
    left, total = iter(jobs), len(jobs) if isinstance(jobs, Sized) else None
    with closing(where.open(shared)) as workers, LiveTable(total) as table:
        running = 0
        while True:
            while running < workers.places and (job := next(left, None)) is not None:
                workers.start(job)
                table.begin(job.name)
                running += 1
            if not running or time.monotonic() > deadline:
                return
            for job, outcome in workers.wait(_LOOK):
                running -= 1
                table.end(job.name)
                yield job, _value(job, outcome)


def in_order(jobs: list[Job], where: Where, shared: Any = None) -> Iterator[Any]:
    """The same, but only what the functions returned, in the order of the jobs."""
    values: dict[str, Any] = {}
    waiting = iter(jobs)
    following = next(waiting, None)
    for job, value in run_jobs(jobs, where, shared):
        values[job.name] = value
        while following is not None and following.name in values:
            yield values.pop(following.name)
            following = next(waiting, None)


def _value(job: Job, outcome: Outcome) -> Any:
    if outcome.refused is not None:
        raise InputError(f"{job.name}: {outcome.refused}")
    if outcome.collided is not None:
        raise RuntimeError(f"{job.name} failed on {outcome.machine}:\n{outcome.collided}")
    return outcome.value
