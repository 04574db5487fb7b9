"""Workers that Ray has, on this machine or on the nodes of a cluster. Only tasks of its core are used.

Nodes share no disk: what a job needs goes out with it, and its folder comes back as bytes. When a worker or its node
dies, Ray does the job again elsewhere; an outcome comes once.
"""

from __future__ import annotations

import os
import socket
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.core.processes import processors
from tb2rl.execution.cargo import packed, unpacked
from tb2rl.execution.job import AGAIN, ONE_THREAD, Job, Outcome, attempt, files_in, write_files

_STORE = 2**28  # [bytes] of a Ray that is started here, for what goes out and comes back; more goes to the disk
_PATIENCE = 10  # [s] until a cluster answers
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0"}
# It keeps to 127.0.0.1, as elsewhere than on Linux, and its workers are as important as processes of ours.
_LOOPBACK = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_worker_niceness": "0",
}

# Variables that a worker on any machine goes by; those with secrets are each machine's own.
_CARRIED = ("MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME", "WANDB_MODE", "WANDB_PROJECT")


class Cluster:
    """Ray's workers.

    Args:
        address: Of a cluster; None: Ray is started on this machine, and ends with this process.
        count: Jobs at once; None: one for each processor of the cluster, also of nodes that come later.
        shared: What all jobs share.

    Raises:
        InputError: If Ray is not installed, or there is no cluster.
    """

    def __init__(self, address: str | None, count: int | None, shared: Any) -> None:
        self._ray = _connected(address, count)
        self._count = count
        self._task = self._ray.remote(num_cpus=1, max_retries=AGAIN)(_do)
        self._cargo = self._ray.put(packed(shared))
        self._running: dict[Any, Job] = {}

    @property
    def places(self) -> int:
        """How many jobs can run at once."""
        processors_there = int(self._ray.cluster_resources().get("CPU", 1))
        return max(1, min(processors_there, self._count or processors_there))

    def start(self, job: Job) -> None:
        """Give a job to Ray."""
        self._running[self._task.remote(self._cargo, job.call, job.folder is not None, _said())] = job

    def wait(self, seconds: float) -> list[tuple[Job, Outcome]]:
        """The jobs that ended meanwhile; returns when there are some, or after so many seconds.

        Raises:
            InputError: If the workers of a job died too often, or the cluster is gone.
        """
        ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=seconds)
        ended = []
        for reference in ready:
            job = self._running.pop(reference)
            try:
                outcome = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                raise InputError(one_line(f"{job.name}: Ray gave it up: {error}")) from None
            if outcome.files is not None and job.folder is not None:
                write_files(outcome.files, job.folder)
            ended.append((job, outcome))
        return ended

    def close(self) -> None:
        """End the jobs that still run. The connection stays, for Ray takes long to start: it ends with this process."""
        if self._ray.is_initialized():
            for reference in self._running:
                self._ray.cancel(reference, force=True)


def _connected(address: str | None, count: int | None) -> Any:
    """The module `ray`, connected."""
    keeps_here = address is None or _is_loopback(address)
    os.environ.update(_QUIET | (_LOOPBACK if keeps_here else {}))  # read as it is imported
    try:
        import ray
    except ModuleNotFoundError:
        raise InputError(f"--on ray needs Ray: {install_extra('ray')}") from None
    if ray.is_initialized():
        return ray
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address is None:
        started: dict[str, Any] = {
            "num_cpus": count or processors(),
            "object_store_memory": _STORE,
            "include_dashboard": False,
        }
        ray.init("local", **started, **quiet)
        return ray
    try:
        socket.create_connection(_split(address), _PATIENCE).close()  # Ray itself would ask for minutes
        ray.init(address, **quiet)
    except (OSError, RuntimeError, ValueError) as error:  # nobody answers, or another version of Ray or Python does
        raise InputError(one_line(f"there is no Ray cluster for us at {address}: {error}")) from None
    return ray


def _split(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"the address of a Ray cluster is HOST:PORT, as `ray start` says it, got {address!r}")
    return host, int(port)


def _is_loopback(address: str) -> bool:
    return _split(address)[0] in ("localhost", "127.0.0.1")


def _said() -> dict[str, str]:
    """What the environment here says of where figures go."""
    return {name: os.environ[name] for name in _CARRIED if name in os.environ}


def _do(cargo: bytes, call: bytes, fills_folder: bool, said: dict[str, str]) -> Outcome:
    """Do a job in a worker of Ray."""
    os.environ.update(ONE_THREAD | said)  # before anything large is imported
    shared = unpacked(cargo)
    if not fills_folder:
        return attempt(call, shared, None)
    with TemporaryDirectory(prefix="tb2rl-job-") as parent:
        folder = Path(parent, "folder")
        outcome = attempt(call, shared, folder)
        files = files_in(folder) if folder.is_dir() else None
    return Outcome(outcome.value, outcome.refused, outcome.collided, files, outcome.machine)
