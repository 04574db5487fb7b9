"""How a command ends: when its reader goes away, and when a pipe of its own breaks."""

from __future__ import annotations

import subprocess
import sys

import pytest

COMMAND = "from tb2rl.errors import InputError, command\n@command\ndef main(arguments):\n    {}\nmain()\n"
ENDS = {
    "a long output": "for i in range(100_000): print(i)",
    "a short one, which waits in the buffer": "print('one line')",
    "a line that is flushed": "print('one line', flush=True)",
    "a table of rich": "from rich.console import Console; Console().print('one line')",
    "the help": "print('help'); raise SystemExit(0)",
}


def ended(code: str, *options: str, both: bool = False) -> tuple[int, str]:
    """Status and stderr of a command whose reader is gone before it writes; of both its streams, if so asked."""
    command = [sys.executable, *options, "-c", f"input()\n{COMMAND.format(code)}"]
    errors = subprocess.STDOUT if both else subprocess.PIPE
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True) as process:
        process.stdout.close()
        process.stdin.write("\n")
        process.stdin.close()
        said = "" if both else process.stderr.read()
        return process.wait(timeout=60), said


@pytest.mark.parametrize("options", [[], ["-u"]], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize("code", ENDS.values(), ids=list(ENDS))
def test_a_command_whose_reader_goes_away_ends_without_a_word(code, options):
    assert ended(code, *options) == (141, "")


def test_an_error_line_that_nobody_reads_ends_a_command_in_the_same_way():
    assert ended("raise InputError('wrong')", both=True) == (141, "")


def test_a_command_that_writes_nothing_keeps_its_status_without_a_reader():
    assert ended("raise InputError('wrong')") == (2, "error: wrong\n")


def test_a_pipe_of_our_own_that_breaks_is_a_bug_and_shows_as_one():
    code = COMMAND.format("raise BrokenPipeError(32, 'Broken pipe')")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "Traceback" in done.stderr
