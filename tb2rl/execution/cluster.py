"""Executor on Ray, either on this machine or on the nodes of a cluster.

Nodes share no disk, so a job is sent with everything that it needs, and its folder is returned as bytes. If a worker or
its node dies, Ray runs the job again elsewhere.
"""

import os
import pickle
import socket
import sys
import sysconfig
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import cloudpickle

import tb2rl
from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.core.files import read_files, write_files
from tb2rl.core.processes import ONE_THREAD, processors
from tb2rl.execution.executor import RETRIES, Executor, Job, Result, deserialize, run_job, serialize

_OBJECT_STORE_SIZE = 2**28  # [bytes] size of the shared memory of a local Ray; what does not fit goes to the disk
_CONNECT_TIMEOUT = 10  # [s]
_NO_TELEMETRY = {"RAY_USAGE_STATS_ENABLED": "0"}
# These variables make a local Ray listen only on 127.0.0.1, and give its workers the normal priority.
_LOCAL_RAY = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_worker_niceness": "0"}

# Environment variables that are copied to workers. Variables with secrets must be set on each machine.
_FORWARDED_VARIABLES = ("MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME", "WANDB_MODE", "WANDB_PROJECT")

_LIBRARY_FOLDERS = {"site-packages", "dist-packages"}
_DATA_SUFFIXES = (".urdf", ".yaml", ".yml", ".json", ".obj", ".stl", ".dae", ".txt")  # files that modules may read
_module_folders: list[TemporaryDirectory[str]] = []  # of the user, in a worker; kept until it ends


class RayExecutor(Executor):
    """Runs jobs on Ray.

    Args:
        address: HOST:PORT of a cluster; None: a Ray on this machine, which ends with this process.
        max_workers: Maximum number of parallel jobs; None: the present number of processors of the cluster.

    Raises:
        InputError: At the first use, if Ray is not installed or there is no cluster at the address.
    """

    remote: ClassVar[bool] = True

    def __init__(self, address: str | None = None, max_workers: int | None = None) -> None:
        self._address, self._max_workers = address, max_workers
        self._running: dict[Any, Job] = {}
        self._references: dict[str, Any] = {}  # Ray's references to the user's modules and to payloads, by digest

    @cached_property
    def _ray(self) -> Any:
        return _connect(self._address, self._max_workers)

    @cached_property
    def _task(self) -> Any:
        return self._ray.remote(num_cpus=1, max_retries=RETRIES)(_run_remote)

    @property
    def num_workers(self) -> int:
        available = int(self._ray.cluster_resources().get("CPU", 1))
        return max(1, min(available, self._max_workers or available))

    def start(self, job: Job, payloads: Mapping[str, bytes]) -> None:
        if list(self._references)[1:] != list(payloads):  # the first reference is that of `UserModules`
            contents = serialize([UserModules()]) | dict(payloads)  # modules first, because other objects need them
            self._references = {digest: self._ray.put(content) for digest, content in contents.items()}
        environment = {name: os.environ[name] for name in _FORWARDED_VARIABLES if name in os.environ}
        self._running[self._task.remote(cloudpickle.dumps(job), self._references, environment)] = job

    def wait(self, seconds: float) -> list[tuple[Job, Result]]:
        ready, _ = self._ray.wait(list(self._running), num_returns=1, timeout=seconds)
        results = []
        for reference in ready:
            job = self._running.pop(reference)
            try:
                result, files = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                raise InputError(one_line(f"{job.name}: Ray could not run the job: {error}")) from None
            if files is not None and job.folder is not None:
                write_files(files, job.folder)
            results.append((job, result))
        return results

    def cancel(self) -> None:
        if self._running and self._ray.is_initialized():
            for reference in self._running:
                self._ray.cancel(reference, force=True)
        self._running.clear()

    def close(self) -> None:
        """Cancel the running jobs; Ray itself runs until this process ends, because its start takes seconds."""
        self.cancel()
        self._references.clear()


def _connect(address: str | None, max_workers: int | None) -> Any:
    """Start Ray, or connect to a cluster; return the module `ray`."""
    host, _, port = (address or "localhost:0").rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"the address of a Ray cluster is HOST:PORT, as `ray start` prints it, got {address!r}")
    is_local = host in ("localhost", "127.0.0.1")
    os.environ.update(_NO_TELEMETRY | (_LOCAL_RAY if is_local else {}))  # before Ray reads these variables on import
    try:
        import ray
    except ModuleNotFoundError:
        raise InputError(f"--on ray needs Ray: {install_extra('ray')}") from None
    if ray.is_initialized():
        return ray
    log_options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address is None:
        cpus = max_workers or processors()
        ray.init("local", num_cpus=cpus, object_store_memory=_OBJECT_STORE_SIZE, include_dashboard=False, **log_options)
        return ray
    try:
        socket.create_connection((host, int(port)), _CONNECT_TIMEOUT).close()  # because Ray's own timeout is minutes
        ray.init(address, **log_options)
    except (OSError, RuntimeError, ValueError) as error:  # no server, or another version of Ray or Python
        raise InputError(one_line(f"no usable Ray cluster at {address}: {error}")) from None
    return ray


def _run_remote(
    pickled_job: bytes, references: Mapping[str, Any], environment: Mapping[str, str]
) -> tuple[Result, Mapping[str, bytes] | None]:
    """Run a job in a worker of Ray; return its result and the files of its folder."""
    os.environ.update({**ONE_THREAD, **environment})  # before libraries read the number of threads
    import ray

    def load() -> Sequence[Any]:
        return deserialize(references, lambda digest: ray.get(references[digest]))[1:]  # without `UserModules`

    load()  # first, because unpickling the job may need the user's modules; the objects stay in a cache
    job: Job = pickle.loads(pickled_job)
    with TemporaryDirectory(prefix="tb2rl-job-") as parent:
        local_folder = Path(parent, "folder")
        result = run_job(load, replace(job, folder=job.folder and local_folder))
        return result, read_files(local_folder) if local_folder.is_dir() else None


class UserModules:
    """The user's modules; unpickling this object makes them importable in another process."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _install, (user_files(),)


def _install(files: Mapping[str, bytes]) -> None:
    if files:
        _module_folders.append(TemporaryDirectory(prefix="tb2rl-modules-"))
        write_files(files, Path(_module_folders[-1].name, "modules"))
        sys.path.insert(0, str(Path(_module_folders[-1].name, "modules")))


def user_files() -> dict[str, bytes]:
    """The source and data files of the user's imported modules, by path relative to a folder on `sys.path`."""
    files: dict[str, bytes] = {}
    for name, file in _user_modules():
        if file.name != "__init__.py":
            files[f"{name}{file.suffix}"] = file.read_bytes()
            data = [path for path in file.parent.glob("*") if path.suffix in _DATA_SUFFIXES]
            files |= {path.name: path.read_bytes() for path in data}
        else:
            files |= {
                f"{name}/{path}": content
                for path, content in read_files(file.parent).items()
                if not any(part.startswith((".", "__pycache__")) for part in path.split("/"))
            }
    return files


def _user_modules() -> Iterator[tuple[str, Path]]:
    """Yield name and file of each imported top-level module that is neither installed nor part of tb2rl."""
    libraries = (sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib"), *tb2rl.__path__)
    folders = [Path(folder).resolve() for folder in libraries]
    for name, module in list(sys.modules.items()):
        path = getattr(module, "__file__", None)
        if not path or not path.endswith(".py") or "." in name or name in ("__main__", "__mp_main__"):
            continue
        file = Path(path).resolve()
        if not _LIBRARY_FOLDERS & set(file.parts) and not any(file.is_relative_to(folder) for folder in folders):
            yield name, file
