"""The executor: runs jobs on workers, as many at once as there are, with one progress table."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from typing import Any, ClassVar

from tb2rl.core.errors import InputError
from tb2rl.execution.job import Job, Result
from tb2rl.execution.payload import Payload, serialize
from tb2rl.execution.table import LiveTable

_POLL = 0.5  # [s] between looks at the number of workers and the deadline


class Executor(ABC):
    """Runs jobs on workers; see the docstring of the package."""

    remote: ClassVar[bool] = False  # whether workers may run on other machines

    def map(self, function: Callable[..., Any], items: Iterable[Any], shared: Sequence[Any] = ()) -> Iterator[Any]:
        """The values of `function(*shared, item)` in the order of the items, each as soon as it is known.

        Args:
            function: Called in a worker; lambdas and functions of the main script work, too.
            items: One argument for each call.
            shared: Objects for all calls.

        Raises:
            InputError: If a call raised one, its workers died too often, or there are no workers.
            RuntimeError: If a call raised another exception; the message has its traceback.
        """
        jobs = [Job(f"part {number}", (item,)) for number, item in enumerate(items)]
        values: dict[str, Any] = {}
        expected = iter(jobs)
        following = next(expected, None)
        for job, value in self._run(function, jobs, shared, math.inf, None):
            values[job.name] = value
            while following is not None and following.name in values:
                yield values.pop(following.name)
                following = next(expected, None)

    def as_completed(
        self,
        function: Callable[..., Any],
        jobs: Iterable[Job],
        shared: Sequence[Any] = (),
        timeout: float | None = None,
    ) -> Iterator[tuple[Job, Any]]:
        """Each job with its value, as it ends; a table on the terminal shows the running ones.

        Args:
            function: Called in a worker as `function(*shared, *job.arguments)`, with `job.folder` at the end if the job
                has one; the folder is complete when the job is yielded.
            jobs: Taken one by one as workers become free.
            shared: Objects for all calls.
            timeout: [s]; None: no limit.

        Raises:
            InputError: As for `map`.
            RuntimeError: As for `map`.
            TimeoutError: After `timeout`; the jobs that still run are terminated.
        """
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        with LiveTable(len(jobs) if isinstance(jobs, Sized) else None) as table:
            yield from self._run(function, jobs, shared, deadline, table)

    def _run(
        self,
        function: Callable[..., Any],
        jobs: Iterable[Job],
        shared: Sequence[Any],
        deadline: float,
        table: LiveTable | None,
    ) -> Iterator[tuple[Job, Any]]:
        payloads = [serialize(value) for value in (function, *shared)]
        left, running = iter(jobs), 0
        try:
            while True:
                while running < self.num_workers and (job := next(left, None)) is not None:
                    self.start(job, payloads)
                    running += 1
                    if table:
                        table.start(job.name)
                if not running:
                    return
                if time.monotonic() > deadline:
                    raise TimeoutError
                for job, result in self.wait(min(_POLL, max(0.0, deadline - time.monotonic()))):
                    running -= 1
                    if table:
                        table.finish(job.name)
                    yield job, _value(job, result)
        finally:
            self.cancel()

    @property
    @abstractmethod
    def num_workers(self) -> int:
        """How many jobs can run at once, now."""

    @abstractmethod
    def start(self, job: Job, payloads: Sequence[Payload]) -> None:
        """Start a job on a free worker; `payloads` are its function and the shared objects."""

    @abstractmethod
    def wait(self, seconds: float) -> list[tuple[Job, Result]]:
        """The jobs that ended: returns when there are some, or after so many seconds."""

    @abstractmethod
    def cancel(self) -> None:
        """Terminate the running jobs."""

    @abstractmethod
    def close(self) -> None:
        """End all workers."""

    def __enter__(self) -> Executor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _value(job: Job, result: Result) -> Any:
    if result.input_error is not None:
        raise InputError(f"{job.name}: {result.input_error}")
    if result.traceback is not None:
        raise RuntimeError(f"{job.name} failed on {result.host}:\n{result.traceback}")
    return result.value
