"""A job: one independent part of the work, its call as a worker runs it, and its result."""

from __future__ import annotations

import platform
import shutil
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tb2rl.core.errors import InputError

RETRIES = 3  # of a job whose worker died


@dataclass(frozen=True)
class Job:
    """One call of a function.

    Attributes:
        name: For messages and the progress table; unique.
        arguments: Of the function, after the shared objects.
        folder: The folder that the function makes, its last argument; None: it makes none and takes none.
    """

    name: str
    arguments: tuple[Any, ...] = ()
    folder: Path | None = None


@dataclass(frozen=True)
class Result:
    """What a job returned or raised.

    Attributes:
        value: The return value.
        input_error: The message of an `InputError`.
        traceback: Of any other exception.
        host: Name of the machine that ran it.
    """

    value: Any = None
    input_error: str | None = None
    traceback: str | None = None
    host: str = ""


def run_job(load: Callable[[], Sequence[Any]], job: Job) -> Result:
    """Run a job in this process; `load` returns its function and the shared objects."""
    host = platform.node()
    folder = () if job.folder is None else (job.folder,)
    try:
        function, *shared = load()
        return Result(function(*shared, *job.arguments, *folder), host=host)
    except InputError as error:
        return Result(input_error=str(error), host=host)
    except Exception:
        return Result(traceback=traceback.format_exc(), host=host)


def read_files(folder: Path) -> dict[str, bytes]:
    """The content of all files in a folder, by relative path."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def write_files(files: Mapping[str, bytes], folder: Path) -> None:
    """Make a folder with these files atomically; it replaces an existing one."""
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
