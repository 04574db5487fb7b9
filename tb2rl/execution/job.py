"""Jobs, their serialization, and their execution in a worker."""

import hashlib
import pickle
import platform
import shutil
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cloudpickle

from tb2rl.core.errors import InputError

RETRIES = 3  # number of retries of a job whose worker died
Result = tuple[Any, Exception | None]  # return value of a job, or the error to raise

_cache: dict[str, Any] = {}  # deserialized objects in this worker, by digest


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


def read_files(folder: Path) -> dict[str, bytes]:
    """Read all files in a folder; returns their contents by relative path."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def write_files(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files into a temporary folder, then replace `folder` by it."""
    folder = folder.absolute()
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as parent:
        staging = Path(parent, "folder")
        staging.mkdir()
        for name, content in files.items():
            (staging / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).write_bytes(content)
        shutil.rmtree(folder, ignore_errors=True)
        staging.rename(folder)
