"""Executors: values and folders, errors, workers that die, and the end of the program."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cloudpickle
import pytest

from tb2rl.core.errors import InputError
from tb2rl.execution.cluster import RayExecutor
from tb2rl.execution.executor import Job
from tb2rl.execution.local import LocalExecutor

cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers cannot import tests
CHECKOUT = Path(__file__).parents[2]
PROGRAM = """
import os, sys, time
from pathlib import Path
from tb2rl.core.command import report_errors
from tb2rl.execution.cluster import RayExecutor
from tb2rl.execution.local import LocalExecutor

def sleep(note):
    Path(note).write_text(str(os.getpid()))
    time.sleep(600)

if __name__ == "__main__":
    with report_errors(), (RayExecutor if sys.argv[1] == "ray" else LocalExecutor)(max_workers=2) as executor:
        list(executor.map(sleep, sys.argv[2:]))
"""


@pytest.fixture(scope="module", params=["local", pytest.param("ray", marks=pytest.mark.slow)])
def executor(request):
    """Two workers of each kind."""
    if request.param == "ray":
        request.getfixturevalue("ray")
    with (RayExecutor if request.param == "ray" else LocalExecutor)(max_workers=2) as executor:
        yield executor


@pytest.fixture
def run(executor):
    """A function that runs one job and returns its value."""

    def run(function, *arguments, folder=None):
        ((_, value),) = executor.as_completed(function, [Job("it", arguments, folder)])
        return value

    return run


class Resource:
    """An object that is opened once in each process."""

    opened = 0

    def count(self, _item):
        self.opened += 1
        return os.getpid(), self.opened


def write_square(offset, number, folder):
    (folder / "inner").mkdir(parents=True)
    (folder / "inner" / "square.txt").write_text(str(number**2))
    return offset + number**2


def fail(error):
    raise error


def die_once(note, folder):
    folder.mkdir()
    (folder / f"{os.getpid()}").touch()
    if not note.exists():
        note.touch()
        die()
    return "done"


def die():
    os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))  # on Windows, SIGTERM kills


def threads():
    import numba
    import torch

    from tb2rl.core.processes import processors

    return torch.get_num_threads(), numba.get_num_threads(), processors()


def test_each_value_and_folder_comes_back_once(executor, tmp_path):
    jobs = [Job(f"job {i}", (i,), tmp_path / str(i)) for i in range(5)]
    done = {job.name: value for job, value in executor.as_completed(write_square, jobs, shared=[100])}
    assert done == {f"job {i}": 100 + i**2 for i in range(5)}
    assert [(tmp_path / str(i) / "inner" / "square.txt").read_text() for i in range(5)] == ["0", "1", "4", "9", "16"]


def test_map_yields_values_in_the_order_of_the_items(executor):
    def wait(delays, number):
        time.sleep(delays[number])
        return number

    assert list(executor.map(wait, range(4), shared=[[0.2, 0.0, 0.1, 0.0]])) == [0, 1, 2, 3]


def test_a_worker_keeps_a_shared_object_between_calls_until_it_changes():
    with LocalExecutor(max_workers=1) as executor:
        resource = Resource()
        counted = [*executor.map(Resource.count, range(2), shared=[resource])]
        counted += executor.map(Resource.count, range(1), shared=[resource])
        resource.opened = 10
        counted += executor.map(Resource.count, range(1), shared=[resource])
        assert [count for _, count in counted] == [1, 2, 3, 11]
        assert len({pid for pid, _ in counted}) == 1, "the process stays"


def test_errors_of_a_job_name_it(run):
    with pytest.raises(InputError, match=r"^it: it does not fit$"):
        run(fail, InputError("it does not fit"))
    with pytest.raises(RuntimeError, match=r"(?s)it failed on .*ZeroDivisionError: a bug"):
        run(fail, ZeroDivisionError("a bug"))


def test_a_job_whose_worker_dies_runs_again_in_an_empty_folder(run, tmp_path):
    assert run(die_once, tmp_path / "note", folder=tmp_path / "folder") == "done"
    assert len(list((tmp_path / "folder").iterdir())) == 1
    with pytest.raises(InputError, match=r"it: (its process died 4 times \(by signal 9\)|Ray could not run the job: )"):
        run(die)


@pytest.mark.slow
def test_a_worker_uses_one_thread(run):
    assert run(threads) == (1, 1, 1)
    assert "TB2RL_PROCESSORS" not in os.environ


@pytest.mark.skipif(sys.platform == "win32", reason="signals as on Linux")
def test_leaving_the_loop_and_the_timeout_terminate_what_runs(tmp_path):
    def note_and_sleep(note):
        note.write_text(str(os.getpid()))
        time.sleep(600)

    with LocalExecutor(max_workers=1) as executor:
        with pytest.raises(TimeoutError):
            list(executor.as_completed(note_and_sleep, [Job("it", (tmp_path / "note",))], timeout=1.0))
        assert list(executor.map(abs, [-1])) == [1], "it goes on with another process"
        values = executor.map(time.sleep, [0, 600])
        next(values)
        values.close()
    if (tmp_path / "note").exists():
        assert not is_running(int((tmp_path / "note").read_text()))


@pytest.mark.skipif(sys.platform == "win32", reason="signals as on Linux")
@pytest.mark.parametrize(
    ("engine", "ending", "to_group"),
    [
        ("local", signal.SIGINT, True),
        pytest.param("local", getattr(signal, "SIGKILL", None), False, marks=pytest.mark.slow),
        pytest.param("ray", signal.SIGINT, False, marks=pytest.mark.slow),
    ],
)
def test_workers_end_with_the_program_without_a_traceback(engine, ending, to_group, tmp_path):
    if engine == "ray":
        pytest.importorskip("ray", reason="Ray is not installed (extra: ray)")
    (tmp_path / "program.py").write_text(PROGRAM)
    notes = [tmp_path / "one", tmp_path / "two"]
    command = [sys.executable, str(tmp_path / "program.py"), engine, *map(str, notes)]
    pipes = {"stdin": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(CHECKOUT)}, **pipes)
    wait_until(lambda: all(note.is_file() and note.read_text() for note in notes), "both jobs run", 240)
    (os.killpg if to_group else os.kill)(process.pid, ending)
    _, error = process.communicate(timeout=60)
    assert process.returncode == (130 if ending == signal.SIGINT else -ending)
    assert error == ""
    workers = [int(note.read_text()) for note in notes]
    wait_until(lambda: not any(map(is_running, workers)), "the workers end", 120)


def wait_until(condition, what: str, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited {seconds} s until {what}"
        time.sleep(0.05)


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"
