"""The command `tb2rl`, which lists and runs all others."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from importlib import import_module

import pytest

import tb2rl
from tb2rl.__main__ import COMMANDS, main

NAMES = "benchmark convert evaluate export play report ros train tune warm worlds zoo"


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_every_command_is_listed_in_a_line(arguments, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    with suppress(SystemExit):  # --help
        main(arguments)
    lines = capsys.readouterr().out.splitlines()
    assert " ".join(COMMANDS) == NAMES
    for name, module in COMMANDS.items():
        (line,) = [line for line in lines if line.split()[:1] == [name]]
        assert line.endswith(import_module(module).__doc__.splitlines()[0])
        assert len(line) <= 80


def test_the_version_is_printed(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert (stopped.value.code, capsys.readouterr().out) == (0, f"tb2rl {tb2rl.__version__}\n")


def test_wrong_input_ends_a_process_with_one_line_and_status_2():
    command = [sys.executable, "-m", "tb2rl", "train", "--set", "gamma"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert done.stderr.startswith("error: ")


def test_an_unknown_command_is_refused(refused):
    message = "error: unknown command 'trian'; did you mean 'train'? known: benchmark, convert, evaluate"
    assert refused(main, "trian").startswith(message)
    assert refused(main, "--agent qlearn").startswith("error: unrecognized arguments: --agent")
