"""A job: one part of the work, how it is sent to a worker, and what comes back."""

from __future__ import annotations

import os
import pickle
import platform
import shutil
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle

from tb2rl.core.errors import InputError

AGAIN = 3  # times that a job is tried again whose worker died
# A worker is one thread, and so is whatever it starts: others work beside it.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "TB2RL_PROCESSORS": "1"}


@dataclass(frozen=True)
class Job:
    """A part of the work that needs no other part.

    Attributes:
        name: What the table calls it; no other job is called so.
        function: Does it. It is called with what all jobs share, the folder that it is to fill, and its arguments.
        arguments: Anything that can be pickled.
        folder: What it leaves on the disk; None: nothing. On another machine it fills one there, whose files come here.
    """

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    folder: Path | None = None

    @property
    def call(self) -> bytes:
        """The function and its arguments, pickled."""
        return cloudpickle.dumps((self.function, self.arguments))


@dataclass(frozen=True)
class Outcome:
    """What came of a job.

    Attributes:
        value: What the function returned.
        refused: The message of an `InputError`.
        collided: The traceback of any other error: a bug.
        files: Of the folder that it filled on another machine, by their path in it.
        machine: The name of the machine.
    """

    value: Any = None
    refused: str | None = None
    collided: str | None = None
    files: Mapping[str, bytes] | None = None
    machine: str = ""


def attempt(call: bytes, shared: Any, folder: Path | None) -> Outcome:
    """Do a job in this process.

    Args:
        call: See `Job.call`.
        shared: What all jobs share.
        folder: That it is to fill.
    """
    machine = platform.node()
    try:
        function, arguments = pickle.loads(call)
        return Outcome(function(shared, folder, *arguments), machine=machine)
    except InputError as error:
        return Outcome(refused=str(error), machine=machine)
    except Exception:
        return Outcome(collided=traceback.format_exc(), machine=machine)


def files_in(folder: Path) -> dict[str, bytes]:
    """The content of all files in a folder, by their path in it."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def write_files(files: Mapping[str, bytes], folder: Path) -> None:
    """Make a folder of what `files_in` read: it appears with everything in it, in the place of one that is there."""
    staging = folder.absolute().with_name(f".{folder.name}.{os.getpid()}")
    try:
        for name, content in files.items():
            (staging / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).write_bytes(content)
        shutil.rmtree(folder, ignore_errors=True)
        staging.rename(folder)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
