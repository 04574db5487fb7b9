"""The processes that run the trials of a study: this many of them, on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, NoReturn

import torch as th

from tb2rl.core.errors import InputError, command
from tb2rl.core.processes import processors
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.study import Search
from tb2rl.tuning.trials import run_trials

_LOOK = 0.1  # [s] between looks at the processes
_START = "from tb2rl.tuning.workers import main; main()"


def run_workers(search: Search, wanted: int, workers: int, seconds: float | None = None) -> bool:
    """Let processes run trials until the study has so many.

    However this ends, its processes end with it, and what they had not finished is lost, no more.

    Args:
        search: The study.
        wanted: Trials that it is to have in the end.
        workers: Processes.
        seconds: Time for it; None: as much as it takes.

    Returns:
        Whether it was over in time.

    Raises:
        InputError: If a process ended before its work was done.
    """
    deadline = None if seconds is None else time.monotonic() + seconds
    with ExitStack() as stack:
        errors = [stack.enter_context(TemporaryFile()) for _ in range(workers)]
        processes = []
        for file in errors:
            processes.append(_start(search.folder, wanted, workers, file))
            stack.callback(_end, processes[-1])
        while any(process.poll() is None for process in processes):
            if any(process.poll() for process in processes):
                break
            if deadline is not None and time.monotonic() > deadline:
                return False
            time.sleep(_LOOK)
        for process, file in zip(processes, errors, strict=True):
            if process.returncode:
                _report(process.returncode, file)
    return True


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.communicate()


def _start(folder: Path, wanted: int, workers: int, errors: IO[bytes]) -> subprocess.Popen[bytes]:
    threads = str(max(1, processors() // workers))
    env = {**os.environ, "NUMBA_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
    words = [sys.executable, "-c", _START, str(folder), str(wanted)]
    # A session of its own, for Ctrl-C is for the process that asked; what it leaves is a pipe that ends with it.
    return subprocess.Popen(words, env=env, stdin=subprocess.PIPE, stderr=errors, start_new_session=True)


def _report(code: int, errors: IO[bytes]) -> NoReturn:
    """Say why a process ended: the line that it said itself, or the traceback of a bug."""
    errors.seek(0)
    said = errors.read().decode(errors="replace")
    if code == 2 and said:
        raise InputError(said.splitlines()[-1].removeprefix("error: "))
    if code < 0:
        raise InputError(f"a process of the study was ended by signal {-code}; the same command goes on")
    print(said, file=sys.stderr)
    raise SystemExit(code)


@command
def main(_: list[str] | None = None) -> None:
    """Run trials in this process: the folder of the study and how many it is to have are its arguments."""
    folder, wanted = sys.argv[1:]
    threading.Thread(target=_end_with_parent, daemon=True).start()
    th.set_num_threads(1)  # a training has its own setting
    search = Search.open(Path(folder))
    with open_study(search) as study:
        run_trials(search, study, int(wanted))


def _end_with_parent() -> None:
    os.read(0, 1)  # nothing is written: it returns when the other end of the pipe is gone
    os._exit(1)
