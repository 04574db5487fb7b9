"""How a command ends: without a reader, with a broken pipe of its own, and with closed or limited streams."""

import os
import shlex
import subprocess
import sys

import pytest

COMMAND = "from tb2rl.core.command import InputError, report_errors\nwith report_errors():\n    {}\n"


def without_reader(code: str, both: bool = False) -> tuple[int, str]:
    """Status and stderr of a command that writes into a closed pipe, with `both` also its stderr."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-c", COMMAND.format(code)]
    errors = subprocess.STDOUT if both else subprocess.PIPE
    done = subprocess.run(command, stdout=writer, stderr=errors, text=True, check=False, timeout=60)
    os.close(writer)
    return done.returncode, done.stderr or ""


def test_a_command_without_a_reader_ends_silently_unless_it_writes_nothing():
    for code in ("print('it waits in the buffer')", "from rich.console import Console; Console().print('one line')"):
        assert without_reader(code) == (141, "")
    assert without_reader("raise InputError('wrong')") == (2, "error: wrong\n")
    assert without_reader("raise InputError('wrong')", both=True) == (141, "")


def in_shell(code: str, redirection: str = "", **environment: str) -> tuple[int, str, str]:
    """Status, stdout and stderr of a command with redirected streams."""
    command = [sys.executable, "-c", "import os, sys\n" + COMMAND.format(code)]
    line, env = f"{shlex.join(command)} {redirection}", {**os.environ, **environment}
    done = subprocess.run(line, shell=True, capture_output=True, encoding="utf-8", env=env, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("code", ["raise BrokenPipeError(32, 'Broken pipe')", r"'\xfc'.encode('ascii')"])
def test_a_bug_shows_as_a_traceback(code):
    status, _, errors = in_shell(code)
    assert status == 1
    assert "Traceback" in errors


@pytest.mark.parametrize(
    ("encoding", "printed"), [("utf-8:strict", "\\udcff ±\n"), ("ascii:surrogateescape", "\\udcff \\xb1\n")]
)
def test_characters_that_the_terminal_lacks_are_printed_escaped(encoding, printed):
    code = "print('\\udcff \\xb1'); print('\\udcff \\xb1', file=sys.stderr)"
    assert in_shell(code, PYTHONIOENCODING=encoding) == (0, printed, printed)


def test_output_to_closed_streams_is_dropped_and_no_file_takes_their_place(tmp_path):
    code = "print('out'); print('err', file=sys.stderr); assert not sys.stderr.isatty() and not sys.stdin.isatty(); "
    code += f"file = open({str(tmp_path / 'file')!r}, 'w'); import ctypes; "
    code += "ctypes.CDLL(None).write(2, b'from a library', 14); file.close()"
    assert in_shell(code, "2>&-") == (0, "out\n", "")
    assert in_shell(code, ">&- 2>&- <&-") == (0, "", "")
    assert (tmp_path / "file").read_text() == ""
    assert in_shell("raise InputError('wrong')", "2>&-")[0] == 2


def test_a_name_that_is_not_text_is_refused_in_one_line():
    line = "error: the name 'runs/\\udcff' is not text in utf-8; use another one\n"
    assert in_shell(r"'runs/\udcff'.encode()") == (2, "", line)
