"""A terminal can be driven in: keys steer, letters and arrows, and q ends."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("task", ["maze", "wall"])
def test_a_terminal_can_be_driven_in(task):
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "LINES": "24", "COLUMNS": "100"}
    environment.pop("DISPLAY", None)
    arguments = [sys.executable, "-m", "tb2rl.play", "--teleop", "--task", task, "--set", "task.start=fixed"]
    playing = subprocess.Popen(arguments, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    try:
        wait_for(ours, b"q ends")
        os.write(ours, b"w\x1bOA")  # a letter, and the arrow up
        wait_for(ours, b"forward")
        os.write(ours, b"q")
        assert playing.wait(timeout=30) == 0
    finally:
        playing.kill()
        playing.wait()
        os.close(ours)


def wait_for(terminal: int, text: bytes) -> None:
    seen = b""
    until = time.monotonic() + 60
    os.set_blocking(terminal, False)
    while text not in seen:
        assert time.monotonic() < until, seen
        time.sleep(0.05)
        try:
            seen += os.read(terminal, 65536)
        except BlockingIOError:
            continue
