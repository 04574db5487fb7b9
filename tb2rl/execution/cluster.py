"""An executor on Ray, on this machine or on the nodes of a cluster; it uses tasks of Ray's core alone.

Nodes share no disk: everything that a job needs travels with it, and its folder comes back as bytes. When a worker or
its node dies, Ray runs the job again elsewhere; each result comes once.
"""

from __future__ import annotations

import os
import pickle
import socket
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import cloudpickle

from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.core.processes import ONE_THREAD, processors
from tb2rl.execution.executor import Executor
from tb2rl.execution.job import RETRIES, Job, Result, read_files, run_job, write_files
from tb2rl.execution.modules import UserModules
from tb2rl.execution.payload import Payload, deserialize, serialize

_OBJECT_STORE = 2**28  # [bytes] of a Ray that is started here; more spills to the disk
_CONNECT_TIMEOUT = 10  # [s]
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0"}
# Ray binds to 127.0.0.1 only, and its workers have the priority of other processes.
_LOOPBACK = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_worker_niceness": "0"}

# Environment variables that workers take over; those with secrets are set on each machine.
_FORWARDED = ("MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME", "WANDB_MODE", "WANDB_PROJECT")


class RayExecutor(Executor):
    """Runs jobs on Ray.

    Args:
        address: HOST:PORT of a cluster; None: starts Ray on this machine, until this process ends.
        max_workers: Parallel jobs; None: one for each processor of the cluster, nodes that join later included.

    Raises:
        InputError: When it is first used, if Ray is not installed or there is no cluster at the address.
    """

    remote: ClassVar[bool] = True

    def __init__(self, address: str | None = None, max_workers: int | None = None) -> None:
        self._address, self._max_workers = address, max_workers
        self._running: dict[Any, Job] = {}
        self._references: dict[str, Any] = {}  # of payloads in Ray's object store, by digest

    @cached_property
    def _ray(self) -> Any:
        return _connect(self._address, self._max_workers)

    @cached_property
    def _task(self) -> Any:
        return self._ray.remote(num_cpus=1, max_retries=RETRIES)(_run_remote)

    @property
    def num_workers(self) -> int:
        """How many jobs can run at once, now."""
        available = int(self._ray.cluster_resources().get("CPU", 1))
        return max(1, min(available, self._max_workers or available))

    def start(self, job: Job, payloads: Sequence[Payload]) -> None:
        """Give a job to Ray."""
        if {payload.digest for payload in payloads} - set(self._references):
            self._modules = serialize(UserModules())
            sent = (self._modules, *payloads)
            self._references = {payload.digest: self._ray.put(payload.content) for payload in sent}
        environment = {name: os.environ[name] for name in _FORWARDED if name in os.environ}
        digests = [self._modules.digest, *(payload.digest for payload in payloads)]  # other objects import the modules
        self._running[self._task.remote(cloudpickle.dumps(job), digests, self._references, environment)] = job

    def wait(self, seconds: float) -> list[tuple[Job, Result]]:
        """The jobs that ended: returns when there are some, or after so many seconds.

        Raises:
            InputError: If the workers of a job died too often, or the cluster is gone.
        """
        ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=seconds)
        ended = []
        for reference in ready:
            job = self._running.pop(reference)
            try:
                result, files = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                raise InputError(one_line(f"{job.name}: Ray gave it up: {error}")) from None
            if files is not None and job.folder is not None:
                write_files(files, job.folder)
            ended.append((job, result))
        return ended

    def cancel(self) -> None:
        """End the running jobs."""
        if self._running and self._ray.is_initialized():
            for reference in self._running:
                self._ray.cancel(reference, force=True)
        self._running.clear()

    def close(self) -> None:
        """End the running jobs; Ray itself ends with this process, because it takes long to start."""
        self.cancel()
        self._references.clear()


def _connect(address: str | None, max_workers: int | None) -> Any:
    """The module `ray`, connected."""
    is_local = address is None or _split(address)[0] in ("localhost", "127.0.0.1")
    os.environ.update(_QUIET | (_LOOPBACK if is_local else {}))  # read when Ray is imported
    try:
        import ray
    except ModuleNotFoundError:
        raise InputError(f"--on ray needs Ray: {install_extra('ray')}") from None
    if ray.is_initialized():
        return ray
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address is None:
        cpus = max_workers or processors()
        ray.init("local", num_cpus=cpus, object_store_memory=_OBJECT_STORE, include_dashboard=False, **quiet)
        return ray
    try:
        socket.create_connection(_split(address), _CONNECT_TIMEOUT).close()  # Ray itself would try for minutes
        ray.init(address, **quiet)
    except (OSError, RuntimeError, ValueError) as error:  # nothing listens, or its version of Ray or Python differs
        raise InputError(one_line(f"no usable Ray cluster at {address}: {error}")) from None
    return ray


def _split(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"the address of a Ray cluster is HOST:PORT, as `ray start` prints it, got {address!r}")
    return host, int(port)


def _run_remote(
    call: bytes, digests: Sequence[str], references: Mapping[str, Any], environment: Mapping[str, str]
) -> tuple[Result, Mapping[str, bytes] | None]:
    """Run a job in a worker of Ray: its result and the files of its folder."""
    os.environ.update({**ONE_THREAD, **environment})  # before anything large is imported
    import ray

    def load() -> Sequence[Any]:
        return deserialize(digests, lambda digest: ray.get(references[digest]))[1:]

    load()  # before the job is unpickled, which may need the user's modules
    job: Job = pickle.loads(call)
    if job.folder is None:
        return run_job(load, job), None
    with TemporaryDirectory(prefix="tb2rl-job-") as parent:
        folder = Path(parent, "folder")
        result = run_job(load, replace(job, folder=folder))
        return result, read_files(folder) if folder.is_dir() else None
