"""How a command ends: a reader that goes away, a broken pipe of its own, and streams that take no such text."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys

import pytest

COMMAND = "from tb2rl.core.errors import InputError, command\n@command\ndef main(arguments):\n    {}\nmain()\n"
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


# ---- streams that cannot take what is printed, and names that are not text

NAMES = "print('\\udcff \\xb1'); print('\\udcff \\xb1', file=sys.stderr)"
STREAMS = {
    "utf-8:strict": ("\\udcff ±\n", "\\udcff ±\n"),
    "ascii": ("\\udcff \\xb1\n", "\\udcff \\xb1\n"),
    "ascii:surrogateescape": ("\\udcff \\xb1\n", "\\udcff \\xb1\n"),
}


def run_in_shell(code: str, redirection: str, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "import sys\n" + COMMAND.format(code)]
    return subprocess.run(
        f"{shlex.join(command)} {redirection}",
        shell=True,
        capture_output=True,
        encoding="utf-8",
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("encoding", STREAMS)
def test_what_the_encoding_of_the_terminal_lacks_is_printed_escaped(encoding):
    done = run_in_shell(NAMES, "", PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stdout, done.stderr) == (0, *STREAMS[encoding])


@pytest.mark.parametrize(
    ("redirection", "said"), [("2>&-", ("out\n", "")), (">&-", ("", "err\n")), (">&- 2>&- <&-", ("", ""))]
)
def test_a_stream_that_was_closed_from_the_start_takes_what_is_printed_and_shows_it_nowhere(redirection, said):
    code = "print('out'); print('err', file=sys.stderr); assert not sys.stderr.isatty() and not sys.stdin.isatty()"
    done = run_in_shell(code, redirection)
    assert (done.returncode, done.stdout, done.stderr) == (0, *said)
    assert run_in_shell("raise InputError('wrong')", redirection).returncode == 2


def test_no_file_takes_the_place_of_a_closed_stream(tmp_path):
    code = f"file = open({str(tmp_path / 'file')!r}, 'w'); import os; os.write(2, b'said by a library'); file.close()"
    assert run_in_shell(code, "2>&-").returncode == 0
    assert (tmp_path / "file").read_text() == ""


def test_a_name_that_is_not_text_ends_in_one_line_where_text_is_needed():
    done = run_in_shell(r"'runs/\udcff'.encode()", "")
    said = "error: the name 'runs/\\udcff' is not text in utf-8; use another one\n"
    assert (done.returncode, done.stderr) == (2, said)
    assert "Traceback" in run_in_shell(r"'\xfc'.encode('ascii')", "").stderr, "a bug shows as one"
