"""Base class of executors, which run jobs on workers in parallel, and the serialization of jobs."""

import hashlib
import math
import pickle
import platform
import sys
import time
import traceback
from abc import abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import cloudpickle
from rich.console import Console
from rich.progress import Progress, TaskID, TextColumn, TimeElapsedColumn

from tb2rl.core.errors import InputError

RETRIES = 3  # number of retries of a job whose worker died
Result = tuple[Any, Exception | None]  # return value of a job, or the error to raise

_cache: dict[str, Any] = {}  # deserialized objects in this worker, by digest
_POLL_PERIOD = 0.5  # [s] period of checking the deadline and the number of workers


@dataclass(frozen=True)
class Job:
    """One call of a function.

    Attributes:
        name: Unique name, for messages and the progress table.
        arguments: Arguments of the function, after the shared ones.
        folder: Folder that the function creates, passed as the last argument. None: no folder, and no such argument.
    """

    name: str
    arguments: tuple[Any, ...] = ()
    folder: Path | None = None


def run_job(load: Callable[[], Iterable[Any]], job: Job) -> Result:
    """Run a job in this process; `load` returns the function and the shared arguments."""
    folder = () if job.folder is None else (job.folder,)
    try:
        function, *shared = load()
        return function(*shared, *job.arguments, *folder), None
    except InputError as error:
        return None, InputError(f"{job.name}: {error}")
    except Exception:
        return None, RuntimeError(f"{job.name} failed on {platform.node()}:\n{traceback.format_exc()}")


def serialize(values: Iterable[Any]) -> dict[str, bytes]:
    """Serialize objects by value, including classes and functions of the main script.

    Returns:
        The serialized objects in the same order, by a digest of position and content.
    """
    contents = [cloudpickle.dumps(value) for value in values]
    return {f"{i} {hashlib.sha256(content).hexdigest()}": content for i, content in enumerate(contents)}


def deserialize(digests: Iterable[str], fetch: Callable[[str], bytes]) -> list[Any]:
    """Deserialize objects, or get them from the cache; objects with other digests are removed from the cache.

    Args:
        digests: Digests of all objects.
        fetch: Function that returns a serialized object by its digest.
    """
    for digest in _cache.keys() - set(digests):
        del _cache[digest]
    for digest in digests:
        if digest not in _cache:
            _cache[digest] = pickle.loads(fetch(digest))
    return [_cache[digest] for digest in digests]


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
            InputError: If a call raised one, if its workers died too often, or if there are no workers.
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
        waiting_jobs, running, num_done = iter(jobs), dict[str, TaskID](), 0
        total = f" of {len(jobs)}" if isinstance(jobs, Sized) else ""
        columns = TextColumn("{task.description}", markup=False), TimeElapsedColumn()
        is_hidden = not (show_progress and sys.stderr.isatty())
        with Progress(*columns, console=Console(stderr=True), transient=True, disable=is_hidden) as table:
            header = table.add_task(f"0{total} done")
            try:
                while True:
                    while len(running) < self.num_workers and (job := next(waiting_jobs, None)) is not None:
                        self.start(job, payloads)
                        running[job.name] = table.add_task(job.name)
                    if not running:
                        return
                    if time.monotonic() > deadline:
                        raise TimeoutError
                    for job, (result, error) in self.wait(min(_POLL_PERIOD, max(0.0, deadline - time.monotonic()))):
                        table.remove_task(running.pop(job.name))
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
