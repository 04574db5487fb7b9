"""Worker processes start from a clean server, without the user's script, and end with their parent."""

import multiprocessing
import multiprocessing.spawn
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from tb2rl.core.processes import hide_main_script

KILLED = """
import os, signal
from concurrent.futures import ProcessPoolExecutor
from tb2rl.core.processes import end_with_parent, hide_main_script, process_context
with hide_main_script():
    pool = ProcessPoolExecutor(1, process_context(), initializer=end_with_parent)
    print(pool.submit(os.getpid).result(), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
EARLY = """
import os, signal, threading, time
from tb2rl.core.processes import hide_main_script, process_context

def interrupt():
    for _ in range(30):
        time.sleep(0.03)
        os.killpg(0, signal.SIGINT)

signal.signal(signal.SIGINT, lambda *_: None)
threading.Thread(target=interrupt).start()
with hide_main_script():
    process = process_context().Process(target=os.getpid)
    process.start()
process.join()
"""


def test_the_users_script_is_hidden_from_new_processes_only(monkeypatch):
    main = sys.modules["__main__"]
    monkeypatch.setattr(main, "__file__", "/home/ada/script.py", raising=False)
    monkeypatch.setattr(main, "__spec__", None)

    def scripts():
        return [key for key in multiprocessing.spawn.get_preparation_data("one") if key.startswith("init_main")]

    with ThreadPoolExecutor(1) as other, hide_main_script():
        assert scripts() == []
        assert (main.__file__, other.submit(scripts).result()) == ("/home/ada/script.py", ["init_main_from_path"])
    assert scripts() == ["init_main_from_path"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_processes_of_a_pool_end_when_their_parent_is_killed():
    done = subprocess.run([sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True, check=False, timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert int(done.stdout) > 0, "the output is complete, so no process holds it open"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is no server")
def test_an_early_ctrl_c_does_not_end_the_fork_server():
    command = [sys.executable, "-c", EARLY]
    done = subprocess.run(command, capture_output=True, text=True, check=False, start_new_session=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
