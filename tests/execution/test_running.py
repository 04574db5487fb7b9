"""Jobs by processes: what comes back, what goes wrong, and what is left when it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tb2rl.core.errors import InputError
from tb2rl.execution.running import in_order, run_jobs
from tb2rl.execution.where import Where

HERE = Where(workers=2)
LONG = """
import sys, time
from pathlib import Path
from tb2rl.execution.job import Job
from tb2rl.execution.running import run_jobs
from tb2rl.execution.where import Where

def sleep(shared, folder, note):
    note.write_text(str(__import__("os").getpid()))
    time.sleep(600)

if __name__ == "__main__":
    notes = [Path(name) for name in sys.argv[2:]]
    jobs = [Job(note.name, sleep, (note,)) for note in notes]
    list(run_jobs(jobs, Where(ray=sys.argv[1] == "ray", workers=2)))
"""


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"


def interrupted(engine: str, folder: Path, how: int) -> tuple[subprocess.Popen, list[int]]:
    """A program whose jobs never end, and which gets a signal once they run; and the processes that ran them."""
    (folder / "program.py").write_text(LONG)
    notes = [folder / "one", folder / "two"]
    command = [sys.executable, str(folder / "program.py"), engine, *map(str, notes)]
    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 240
    while not all(note.is_file() and note.read_text() for note in notes):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.1)
    process.send_signal(how)
    process.communicate(timeout=60)
    return process, [int(note.read_text()) for note in notes]


def ended(pids: list[int]) -> bool:
    """Whether processes end by themselves soon."""
    deadline = time.monotonic() + 30
    while any(map(is_running, pids)) and time.monotonic() < deadline:
        time.sleep(0.1)
    return not any(map(is_running, pids))


def test_values_and_folders_come_back_each_once(make_job, tmp_path):
    jobs = [make_job(f"job {i}", "square", i, folder=tmp_path / str(i)) for i in range(5)]
    done = {job.name: value for job, value in run_jobs(jobs, HERE, {"offset": 100})}
    assert done == {f"job {i}": 100 + i**2 for i in range(5)}
    assert [(tmp_path / str(i) / "inner" / "square.txt").read_text() for i in range(5)] == ["0", "1", "4", "9", "16"]


def test_values_come_in_the_order_of_the_jobs(make_job):
    jobs = [make_job(f"job {i}", "square", i) for i in range(6)]
    assert list(in_order(jobs, HERE, {"offset": 0})) == [0, 1, 4, 9, 16, 25]


def test_what_a_job_refuses_is_said_with_its_name(make_job):
    with pytest.raises(InputError, match=r"^seed 3: it does not fit$"):
        list(run_jobs([make_job("seed 3", "refuse")], HERE))
    with pytest.raises(RuntimeError, match=r"(?s)seed 3 failed on .*ZeroDivisionError: a bug"):
        list(run_jobs([make_job("seed 3", "collision")], HERE))


def test_a_job_whose_process_dies_is_done_again_in_an_empty_folder(make_job, tmp_path):
    job = make_job("it", "die_once", tmp_path / "note", folder=tmp_path / "folder")
    assert [value for _, value in run_jobs([job], HERE)] == ["done"]
    assert len(list((tmp_path / "folder").iterdir())) == 1


def test_a_job_whose_processes_die_every_time_is_given_up(make_job):
    with pytest.raises(InputError, match=r"it: its process died 4 times \(by signal 9\)"):
        list(run_jobs([make_job("it", "die")], HERE))


@pytest.mark.slow
def test_a_worker_is_one_thread(make_job):
    assert [value for _, value in run_jobs([make_job("it", "threads")], HERE)] == [(1, 1, 1)]
    assert "TB2RL_PROCESSORS" not in os.environ


@pytest.mark.skipif(sys.platform == "win32", reason="signals as on Linux")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_however_it_ends_its_processes_end_with_it(how, tmp_path):
    process, workers = interrupted("processes", tmp_path, how)
    assert process.returncode != 0
    assert ended(workers)
