"""The command `report`: where the page goes, what is printed, and one line for what does not fit."""

from __future__ import annotations

import json
import os
import shutil
import sys
from io import StringIO
from pathlib import Path

import pytest

from tb2rl import report, train
from tb2rl.commands import report as work
from tb2rl.runs.folder import EVALUATION
from tb2rl.showing import subjects


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run folder with a policy that knows next to nothing."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train("qlearn", total_timesteps=8, n_envs=1, eval_freq=0, folder=folder)
    return folder


@pytest.fixture(autouse=True)
def brief(monkeypatch) -> None:
    """Evaluations that are made for the page: one episode."""
    monkeypatch.setattr(subjects, "_EPISODES", 1)


def test_the_page_of_one_run_is_in_its_folder_and_its_path_is_printed(run, capsys):
    report.main([str(run)])
    out, err = capsys.readouterr()
    page = run / "report.html"
    assert out == f"{page}: 1 run, {page.stat().st_size / 1e6:.1f} MB\n"
    assert err == "", "no bars where there is no terminal"
    assert page.read_text(encoding="utf-8").lstrip().startswith("<!DOCTYPE html>")
    page.unlink()


def test_a_terminal_sees_bars(run, tmp_path, monkeypatch, capsys):
    stream = StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    report.main([str(run), "--out", str(tmp_path / "it.html")])
    drawn = stream.getvalue()
    assert [what for what in ("reading:", "evaluating:", "drawing:") if what not in drawn] == []
    assert capsys.readouterr().out.count("\n") == 1


def test_a_zoo_entry_has_a_page_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report.main(["zoo:maze-loop-ppo"])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "zoo:maze-loop-ppo" in page
    assert [
        name for name in ("runs", "evaluation", "paths", "time", "actions", "map") if f'id="{name}"' not in page
    ] == []


# ---- what is refused


def assert_refused(arguments: list[object], named: list[str], capsys) -> None:
    with pytest.raises(SystemExit) as stopped:
        report.main([*map(str, arguments)])
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.count("\n") == 1, message
    assert [part for part in named if part not in message] == [], message


@pytest.mark.parametrize(
    ("reference", "named"),
    [
        ("missing", ["no run folder missing"]),
        (".", ["neither a run folder nor a folder of them"]),
        ("file", ["no run folder file"]),
        ("zoo:missing", ["unknown zoo policy", "maze-loop-qlearn"]),
    ],
)
def test_what_is_not_a_run_is_refused(reference, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert_refused([reference], named, capsys)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("out", ["missing/it.html", "."])
def test_a_page_that_cannot_be_written_is_refused_before_any_work(out, run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(work, "read_subject", None)
    assert_refused([run, "--out", out], ["cannot write", out], capsys)


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write anywhere")
def test_a_folder_that_cannot_be_written_is_refused(run, tmp_path, capsys):
    tmp_path.chmod(0o500)
    assert_refused([run, "--out", tmp_path / "it.html"], ["cannot write", "it.html"], capsys)


def test_a_disk_that_is_full_is_one_line(run, tmp_path, monkeypatch, capsys):
    def full(path, text):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(work, "write_text", full)
    assert_refused([run, "--out", tmp_path / "it.html"], ["cannot write", "it.html", "No space left"], capsys)


@pytest.mark.parametrize("argument", ["RUN", "--out"])
def test_a_name_that_is_too_long_is_refused(argument, run, capsys):
    arguments = ["r" * 300] if argument == "RUN" else [run, "--out", "r" * 300]
    assert_refused(arguments, ["too long", "rrr"], capsys)


def test_one_training_in_two_folders_is_refused(run, tmp_path, capsys):
    twins = [shutil.copytree(run, tmp_path / name) for name in ("first", "second")]
    assert_refused([*twins, "--out", tmp_path / "it.html"], ["first and second are the same training"], capsys)


def test_a_run_that_is_damaged_leaves_no_page(run, tmp_path, capsys):
    damaged = shutil.copytree(run, tmp_path / "run")
    (damaged / EVALUATION).write_text(json.dumps({"each": []}))
    (damaged / "episodes.safetensors").write_bytes(b"no arrays")
    assert_refused([damaged], ["episodes.safetensors"], capsys)
    assert not (damaged / "report.html").exists()
