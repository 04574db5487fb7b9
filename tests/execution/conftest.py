"""What jobs of these tests do; their functions travel by value, for workers cannot import tests."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import cloudpickle
import pytest

from tb2rl.core.errors import InputError
from tb2rl.execution.job import Job

cloudpickle.register_pickle_by_value(sys.modules[__name__])


def square(shared, folder, number):
    if folder is not None:
        folder.mkdir()
        (folder / "inner").mkdir()
        (folder / "inner" / "square.txt").write_text(str(number**2))
    return shared["offset"] + number**2


def refuse(shared, folder):
    raise InputError("it does not fit")


def crash(shared, folder):
    raise ZeroDivisionError("a bug")


def die_once(shared, folder, note):
    """Die the first time, with a half-written folder."""
    folder.mkdir()
    (folder / f"{os.getpid()}").touch()
    if not note.exists():
        note.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def die(shared, folder):
    os.kill(os.getpid(), signal.SIGKILL)


def threads(shared, folder):
    import numba
    import torch

    from tb2rl.core.processes import processors

    return torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS, processors()


def sleep(shared, folder, note, seconds):
    note.touch()
    time.sleep(seconds)


def _job(name: str, function: str, *arguments: object, folder: Path | None = None) -> Job:
    return Job(name, globals()[function], arguments, folder)


@pytest.fixture
def make_job():
    """The function `_job`."""
    return _job


@pytest.fixture(scope="module")
def ray():
    """Ray, which ends with the tests of a module."""
    module = pytest.importorskip("ray", reason="Ray is not installed (extra: ray)")
    yield module
    module.shutdown()
