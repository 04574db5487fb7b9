"""Workers that are processes of this machine. One that dies is replaced, and its job is tried again."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import connection
from multiprocessing.connection import Connection
from typing import Any

import cloudpickle
from tqdm import tqdm  # type: ignore[import-untyped]

from tb2rl.core.errors import InputError
from tb2rl.core.processes import end_with_parent, main_hidden
from tb2rl.execution.job import AGAIN, ONE_THREAD, Job, Outcome, attempt

_GRACE = 30.0  # [s] for a job to end well: a rollout can be long
_CONTEXT = multiprocessing.get_context("spawn")  # anew: how many threads it has is decided before anything is imported


class Processes:
    """Processes that do one job after the other.

    Args:
        count: How many at most; they start as they are needed.
        shared: What all jobs share.
    """

    def __init__(self, count: int, shared: Any) -> None:
        self.places = count
        self._shared = cloudpickle.dumps(shared)
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, Job]] = {}
        self._deaths: Counter[str] = Counter()

    def start(self, job: Job) -> None:
        """Let a process do a job; there is a free place."""
        worker = self._idle.pop() if self._idle else _Worker(self._shared)
        worker.connection.send((job.call, job.folder))
        self._busy[worker.connection] = (worker, job)

    def wait(self, seconds: float) -> list[tuple[Job, Outcome]]:
        """The jobs that ended meanwhile; returns when there are some, or after so many seconds.

        Raises:
            InputError: If the processes of a job died too often.
        """
        ended = []
        for ready in connection.wait(list(self._busy), seconds):
            assert isinstance(ready, Connection)
            worker, job = self._busy.pop(ready)
            try:
                ended.append((job, ready.recv()))
                self._idle.append(worker)
            except (EOFError, ConnectionResetError):
                self._try_again(worker, job)
        return ended

    def _try_again(self, worker: _Worker, job: Job) -> None:
        worker.end()
        self._deaths[job.name] += 1
        if self._deaths[job.name] > AGAIN:
            raise InputError(f"{job.name}: its process died {AGAIN + 1} times ({worker.how})")
        if job.folder is not None:
            shutil.rmtree(job.folder, ignore_errors=True)  # it begins anew, as on another machine
        self.start(job)

    def close(self) -> None:
        """End the processes; a training in one may save a checkpoint first, see `StopOnInterrupt`."""
        workers = [*self._idle, *(worker for worker, _ in self._busy.values())]
        for worker in workers:
            worker.process.terminate()
        until = time.monotonic() + _GRACE
        for worker in workers:
            worker.process.join(max(0.0, until - time.monotonic()))
            worker.end()


class _Worker:
    def __init__(self, shared: bytes) -> None:
        self.connection, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=_serve, args=(theirs, shared))
        with main_hidden(), _one_thread():
            self.process.start()
        theirs.close()  # so that the pipe ends with the process

    @property
    def how(self) -> str:
        """How the process ended."""
        code = self.process.exitcode or 0
        return f"by signal {-code}" if code < 0 else f"with status {code}"

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


@contextmanager
def _one_thread() -> Iterator[None]:
    """What starts in this block has one thread."""
    before = dict(os.environ)
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _serve(jobs: Connection, shared: bytes) -> None:
    """What a process does."""
    end_with_parent()
    if hasattr(os, "setsid"):
        os.setsid()  # Ctrl-C is for the process that asked
    tqdm.set_lock(threading.RLock())  # in place of a semaphore, which a process that is killed leaves behind
    known = cloudpickle.loads(shared)
    with suppress(EOFError, KeyboardInterrupt):  # no more jobs; a training that was asked to end
        while True:
            call, folder = jobs.recv()
            jobs.send(attempt(call, known, folder))
