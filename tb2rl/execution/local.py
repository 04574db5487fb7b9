"""Executor on local processes, which replaces processes that die."""

from __future__ import annotations

import atexit
import os
import pickle
import shutil
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from multiprocessing import connection
from multiprocessing.connection import Connection
from typing import Any

import cloudpickle
from tqdm import tqdm  # type: ignore[import-untyped]

from tb2rl.core.errors import InputError
from tb2rl.core.processes import ONE_THREAD, end_with_parent, hide_main_script, process_context, processors
from tb2rl.execution.executor import RETRIES, Executor, Job, Result, deserialize, run_job

_TERMINATION_TIMEOUT = 30.0  # [s] time for a training to finish its rollout and save a checkpoint


class LocalExecutor(Executor):
    """Runs jobs on local processes.

    Args:
        max_workers: Maximum number of processes; None: one for each processor.
    """

    def __init__(self, max_workers: int | None = None) -> None:
        self._max_workers = max_workers or processors()
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, _Worker] = {}
        atexit.register(self.close)  # runs before the exit handler of `multiprocessing`, which joins all processes

    @property
    def num_workers(self) -> int:
        return self._max_workers

    def start(self, job: Job, payloads: Mapping[str, bytes], num_deaths: int = 0) -> None:
        worker = self._idle.pop() if self._idle else _Worker()
        self._busy[worker.connection] = worker
        worker.send(job, payloads, num_deaths)

    def wait(self, seconds: float) -> list[tuple[Job, Result]]:
        results = []
        ready: list[Any] = connection.wait(list(self._busy), seconds)
        for pipe in ready:
            worker = self._busy[pipe]
            try:
                result = pipe.recv()
            except (EOFError, ConnectionResetError):
                self._retry(worker)
                continue
            del self._busy[pipe]
            self._idle.append(worker)
            results.append((worker.job, result))
        return results

    def _retry(self, worker: _Worker) -> None:
        del self._busy[worker.connection]
        worker.kill()
        job, num_deaths = worker.job, worker.num_deaths + 1
        if num_deaths > RETRIES:
            code = worker.process.exitcode or 0
            reason = f"by signal {-code}" if code < 0 else f"with status {code}"
            raise InputError(f"{job.name}: its process died {num_deaths} times ({reason})")
        if job.folder is not None:
            shutil.rmtree(job.folder, ignore_errors=True)
        self.start(job, worker.payloads, num_deaths)

    def cancel(self) -> None:
        """Terminate the running jobs; a training has time to save a checkpoint."""
        busy = list(self._busy.values())
        self._busy.clear()
        _terminate(busy)

    def close(self) -> None:
        atexit.unregister(self.close)
        self.cancel()
        _terminate(self._idle)
        self._idle.clear()


class _Worker:
    """A worker process, the pipe to it, and its present job."""

    job: Job
    num_deaths: int

    def __init__(self) -> None:
        context = process_context()
        self.connection, worker_end = context.Pipe()
        self.process = context.Process(target=_run_jobs, args=(worker_end, {**os.environ, **ONE_THREAD}))
        self.payloads: Mapping[str, bytes] = {}  # the last function and shared arguments, which the process has cached
        with hide_main_script():
            self.process.start()
        worker_end.close()  # so that the pipe closes when the process dies

    def send(self, job: Job, payloads: Mapping[str, bytes], num_deaths: int) -> None:
        """Send a job with the payloads that the process has not cached; `num_deaths` workers have died at this job."""
        missing = {digest: payloads[digest] for digest in payloads.keys() - self.payloads.keys()}
        self.job, self.payloads, self.num_deaths = job, payloads, num_deaths
        with suppress(BrokenPipeError, ConnectionResetError):  # the process has died, and `wait` will retry the job
            self.connection.send_bytes(cloudpickle.dumps((job, list(payloads), missing)))

    def kill(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def _terminate(workers: Iterable[_Worker]) -> None:
    deadline = time.monotonic() + _TERMINATION_TIMEOUT
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        worker.process.join(max(0.0, deadline - time.monotonic()))
        worker.kill()


def _run_jobs(pipe: Connection, environment: Mapping[str, str]) -> None:
    """Run jobs in a worker process until the pipe is closed."""
    end_with_parent()
    if hasattr(os, "setsid"):
        os.setsid()  # new session, so that Ctrl-C interrupts only the main process
    os.environ.clear()  # because the process has inherited the environment of the fork server
    os.environ.update(environment)
    tqdm.set_lock(threading.RLock())  # because a killed process would leak tqdm's default lock, a semaphore
    with suppress(EOFError, KeyboardInterrupt):  # the pipe was closed, or SIGTERM ended a training
        while True:
            job, digests, contents = pickle.loads(pipe.recv_bytes())
            pipe.send(run_job(partial(deserialize, digests, contents.__getitem__), job))
