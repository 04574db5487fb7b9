"""All commands by one name, `tb2rl`."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

import tb2rl
from tb2rl.__main__ import COMMANDS, main


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_it_lists_every_command_in_a_line(arguments):
    done = subprocess.run([sys.executable, "-m", "tb2rl", *arguments], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    for name, home in COMMANDS.items():
        (line,) = [line for line in lines if line.split()[:1] == [name]]
        assert line.endswith(import_module(home).__doc__.splitlines()[0])
        assert len(line) <= 80


def test_it_says_its_version(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert (stopped.value.code, capsys.readouterr().out) == (0, f"tb2rl {tb2rl.__version__}\n")


def test_it_runs_a_command_with_its_arguments(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    quick = "--total-timesteps 8 --n-envs 1 --eval-freq 0 --no-evaluation --name it --simulation kinematic"
    main(["train", *quick.split()])
    assert "runs/maze/qlearn/it" in capsys.readouterr().out
    assert (tmp_path / "runs" / "maze" / "qlearn" / "it" / "final" / "policy.safetensors").is_file()


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_after_a_command_is_that_commands_own(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    assert (stopped.value.code, f"python -m tb2rl.{name}" in capsys.readouterr().out) == (0, True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["trian"], "error: unknown command 'trian'; did you mean 'train'? known: benchmark, convert, evaluate"),
        (["--agent", "qlearn"], "error: unrecognized arguments: --agent"),
        (["train", "--agent", "qlern"], "error: unknown agent 'qlern'; did you mean 'qlearn'?"),
    ],
)
def test_what_it_does_not_know_is_one_line(arguments, words, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.startswith(words)
    assert message.count("\n") == 1
