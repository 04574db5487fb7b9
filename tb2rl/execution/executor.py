"""Base class of executors: runs jobs on workers in parallel, and shows a progress table."""

import math
import sys
import time
from abc import abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import AbstractContextManager, closing
from typing import Any, ClassVar

from rich.console import Console
from rich.progress import Progress, TaskID, TextColumn, TimeElapsedColumn

from tb2rl.execution.job import Job, Result, serialize

_POLL_PERIOD = 0.5  # [s] period of checking the deadline and the number of workers


class Executor(AbstractContextManager["Executor"]):
    """Runs jobs on workers; see the docstring of the package."""

    remote: ClassVar[bool] = False  # whether workers may run on other machines

    def map(self, function: Callable[..., Any], items: Iterable[Any], shared: Sequence[Any] = ()) -> Iterator[Any]:
        """Yield the results of `function(*shared, item)` in the order of the items.

        Args:
            function: Function to call in a worker; it may be a lambda or defined in the main script.
            items: One argument for each call.
            shared: Arguments for all calls.

        Raises:
            InputError: If a call raised one, the workers of a retried call died too often, or there are no workers.
            RuntimeError: If a call raised another exception; the message has its traceback.
        """
        jobs = [Job(f"part {number}", (item,)) for number, item in enumerate(items)]
        results: dict[str, Any] = {}
        with closing(self.as_completed(function, jobs, shared, show_progress=False)) as completed:
            for job in jobs:
                while job.name not in results:
                    finished, result = next(completed)
                    results[finished.name] = result
                yield results.pop(job.name)

    def as_completed(
        self,
        function: Callable[..., Any],
        jobs: Iterable[Job],
        shared: Sequence[Any] = (),
        timeout: float = math.inf,
        show_progress: bool = True,
    ) -> Generator[tuple[Job, Any], None, None]:
        """Yield each job with its result when the job ends.

        Args:
            function: Function to call in a worker as `function(*shared, *job.arguments)`, with the folder of
                the job, if it has one, as last argument. The folder is on this machine when the job is yielded.
            jobs: Jobs, which start when workers become free.
            shared: Arguments for all calls.
            timeout: Time limit [s].
            show_progress: Whether to show a table of the running jobs, if stderr is a terminal.

        Raises:
            InputError: See `map`.
            RuntimeError: See `map`.
            TimeoutError: After `timeout`; the running jobs are terminated.
        """
        deadline, payloads = time.monotonic() + timeout, serialize([function, *shared])
        waiting_jobs, rows, num_done = iter(jobs), dict[str, TaskID](), 0
        total = f" of {len(jobs)}" if isinstance(jobs, Sized) else ""
        columns = TextColumn("{task.description}", markup=False), TimeElapsedColumn()
        is_hidden = not (show_progress and sys.stderr.isatty())
        with Progress(*columns, console=Console(stderr=True), transient=True, disable=is_hidden) as table:
            header = table.add_task(f"0{total} done")
            try:
                while True:
                    while len(rows) < self.num_workers and (job := next(waiting_jobs, None)) is not None:
                        self.start(job, payloads)
                        rows[job.name] = table.add_task(job.name)
                    if not rows:
                        return
                    if time.monotonic() > deadline:
                        raise TimeoutError
                    for job, (result, error) in self.wait(min(_POLL_PERIOD, max(0.0, deadline - time.monotonic()))):
                        table.remove_task(rows.pop(job.name))
                        if error is not None:
                            raise error
                        num_done += 1
                        table.update(header, description=f"{num_done}{total} done")
                        yield job, result
            finally:
                self.cancel()

    @property
    @abstractmethod
    def num_workers(self) -> int:
        """The present number of workers, which can change."""

    @abstractmethod
    def start(self, job: Job, payloads: Mapping[str, bytes]) -> None:
        """Start a job on a free worker; `payloads` maps digests to the serialized function and shared arguments."""

    @abstractmethod
    def wait(self, seconds: float) -> list[tuple[Job, Result]]:
        """Wait until a job ends, at most `seconds`; return the jobs that ended, with their results.

        Raises:
            InputError: If the workers of a job died too often, or there are no workers.
        """

    @abstractmethod
    def cancel(self) -> None:
        """Terminate the running jobs."""

    @abstractmethod
    def close(self) -> None:
        """End all workers."""

    def __exit__(self, *_: object) -> None:
        self.close()
