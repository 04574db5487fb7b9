"""The command `tb2rl`, which lists and runs all others."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest

import tb2rl
from tb2rl.__main__ import COMMANDS, main

CHECKOUT = Path(__file__).parent.parent
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


def test_a_command_runs_with_its_arguments(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    quick = "--total-timesteps 8 --n-envs 1 --eval-freq 0 --no-evaluation --name it --simulation kinematic"
    main(["train", *quick.split()])
    assert "runs/maze/qlearn/it" in capsys.readouterr().out
    assert (tmp_path / "runs" / "maze" / "qlearn" / "it" / "final" / "policy.safetensors").is_file()


def test_wrong_input_ends_a_process_with_one_line_and_status_2():
    command = [sys.executable, "-m", "tb2rl", "train", "--agent", "qlern"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert done.stderr.startswith("error: unknown agent 'qlern'; did you mean 'qlearn'?")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["trian"], "error: unknown command 'trian'; did you mean 'train'? known: benchmark, convert, evaluate"),
        (["--agent", "qlearn"], "error: unrecognized arguments: --agent"),
    ],
)
def test_an_unknown_command_is_refused(arguments, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    error = capsys.readouterr().err
    assert (stopped.value.code, error.count("\n")) == (2, 1)
    assert error.startswith(message)


def test_the_import_contract_orders_every_room():
    """import-linter can check this only for modules as well, so that each new command would need an entry there."""
    contract, *_ = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    ordered = " | ".join(contract["layers"]).split(" | ")
    assert {file.parent.name for file in (CHECKOUT / "tb2rl").glob("*/__init__.py")} <= {*ordered}
