"""An executor on processes of this machine; a process that dies is replaced."""

from __future__ import annotations

import atexit
import os
import pickle
import shutil
import threading
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing import connection
from multiprocessing.connection import Connection

import cloudpickle
from tqdm import tqdm  # type: ignore[import-untyped]

from tb2rl.core.errors import InputError
from tb2rl.core.processes import ONE_THREAD, end_with_parent, main_hidden, process_context, processors
from tb2rl.execution.executor import Executor
from tb2rl.execution.job import RETRIES, Job, Result, run_job
from tb2rl.execution.payload import Payload, deserialize

_GRACE = 30.0  # [s] for terminated jobs to end: a training may save a checkpoint, and a rollout can be long


class LocalExecutor(Executor):
    """Runs jobs on processes of this machine.

    Args:
        max_workers: Processes; None: one for each processor.
    """

    def __init__(self, max_workers: int | None = None) -> None:
        self._max_workers = max_workers or processors()
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, Job, Sequence[Payload]]] = {}
        self._deaths: Counter[str] = Counter()
        atexit.register(self.close)  # before `multiprocessing` waits for the processes

    @property
    def num_workers(self) -> int:
        """How many jobs can run at once."""
        return self._max_workers

    def start(self, job: Job, payloads: Sequence[Payload]) -> None:
        """Start a job on an idle process or a new one."""
        worker = self._idle.pop() if self._idle else _Worker()
        self._busy[worker.connection] = (worker, job, payloads)
        with suppress(BrokenPipeError, ConnectionResetError):  # a worker that died meanwhile: `wait` notices
            worker.send(job, payloads)

    def wait(self, seconds: float) -> list[tuple[Job, Result]]:
        """The jobs that ended: returns when there are some, or after so many seconds.

        Raises:
            InputError: If the processes of a job died too often.
        """
        ended = []
        for ready in connection.wait(list(self._busy), seconds):
            assert isinstance(ready, Connection)
            worker, job, payloads = self._busy[ready]
            try:
                result = ready.recv()
            except (EOFError, ConnectionResetError):
                self._retry(worker, job, payloads)
                continue
            del self._busy[ready]
            self._idle.append(worker)
            self._deaths.pop(job.name, None)
            ended.append((job, result))
        return ended

    def _retry(self, worker: _Worker, job: Job, payloads: Sequence[Payload]) -> None:
        del self._busy[worker.connection]
        worker.end()
        self._deaths[job.name] += 1
        if self._deaths[job.name] > RETRIES:
            raise InputError(f"{job.name}: its process died {RETRIES + 1} times ({worker.cause_of_death})")
        if job.folder is not None:
            shutil.rmtree(job.folder, ignore_errors=True)
        self.start(job, payloads)

    def cancel(self) -> None:
        """Terminate the processes of the running jobs; a training in one may save a checkpoint first."""
        busy = [worker for worker, *_ in self._busy.values()]
        self._busy.clear()
        self._deaths.clear()
        _terminate(busy)

    def close(self) -> None:
        """End all processes."""
        atexit.unregister(self.close)
        self.cancel()
        _terminate(self._idle)
        self._idle.clear()


class _Worker:
    """A process and the pipe to it."""

    def __init__(self) -> None:
        context = process_context()
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, {**os.environ, **ONE_THREAD}))
        self._sent: set[str] = set()  # digests of the payloads that it keeps
        with main_hidden():
            self.process.start()
        theirs.close()  # so that the pipe ends with the process

    def send(self, job: Job, payloads: Sequence[Payload]) -> None:
        """Send a job, and the payloads that the worker lacks."""
        digests = [payload.digest for payload in payloads]
        missing = {payload.digest: payload.content for payload in payloads if payload.digest not in self._sent}
        self._sent = set(digests)
        self.connection.send_bytes(cloudpickle.dumps((job, digests, missing)))

    @property
    def cause_of_death(self) -> str:
        """Signal or exit status that ended the process."""
        code = self.process.exitcode or 0
        return f"by signal {-code}" if code < 0 else f"with status {code}"

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def _terminate(workers: Iterable[_Worker]) -> None:
    deadline = time.monotonic() + _GRACE
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        worker.process.join(max(0.0, deadline - time.monotonic()))
        worker.end()


def _serve(jobs: Connection, environment: Mapping[str, str]) -> None:
    """Run jobs until the pipe ends."""
    end_with_parent()
    if hasattr(os, "setsid"):
        os.setsid()  # a session of its own: Ctrl-C reaches the process that started it alone
    os.environ.clear()  # a process of the fork server has the environment of its server
    os.environ.update(environment)
    tqdm.set_lock(threading.RLock())  # instead of a semaphore, which a process that is killed would leave behind
    with suppress(EOFError, KeyboardInterrupt):  # no more jobs; a training that was terminated
        while True:
            job, digests, contents = pickle.loads(jobs.recv_bytes())
            jobs.send(run_job(partial(deserialize, digests, contents.__getitem__), job))
