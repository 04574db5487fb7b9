"""The command `report`: where the page goes, what is printed, and one line for what does not fit."""

from __future__ import annotations

import json
import os
import shutil
import sys
from importlib import import_module
from io import StringIO
from pathlib import Path

import pytest

from tb2rl import report, train
from tb2rl.commands import report as work
from tb2rl.evaluation import suites
from tb2rl.runs.folder import EVALUATION
from tb2rl.viz import subjects


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


# ---- results of suites


@pytest.fixture
def navigator(small_suite, monkeypatch, tmp_path) -> Path:
    """A run folder that keeps the result of `unseen`, which is three small worlds here."""
    folder = tmp_path / "navigator"
    settings = {"task.world": "loop", "task.named_actions": True, "task.observe": ["goal"]}
    train("qlearn", "navigate", settings=settings, total_timesteps=8, n_envs=1, eval_freq=0, save_freq=0, folder=folder)
    for module in (import_module("tb2rl.commands.suite"), suites):
        monkeypatch.setattr(module, "find_suite", lambda name, path: small_suite(name))
    import_module("tb2rl.evaluate").main([str(folder), "--suite", "unseen", "--workers", "1"])
    return folder


def test_the_page_of_a_run_has_what_it_did_in_suites(navigator, capsys):
    report.main([str(navigator)])
    assert ": 1 run, 1 suite, " in capsys.readouterr().out
    page = (navigator / "report.html").read_text(encoding="utf-8")
    assert [name for name in ("runs", "evaluation", "suite-1") if f'id="{name}"' not in page] == []
    assert page.count("data:image/gif") == 3


def test_a_result_has_a_page_of_its_own_wherever_it_is(navigator, tmp_path, monkeypatch, capsys):
    """Also where the policy that it names is no longer there, but beside it."""
    moved = navigator.rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    report.main(["moved/suite-unseen.json", str(moved / "suite-unseen.json")])
    assert "report.html: 1 suite, " in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert 'id="runs"' not in page
    assert page.count("data:image/gif") == 3


@pytest.mark.parametrize("content", ["", "{}", '{"failure_free_rate": 1.0}', "[1, 2"])
def test_a_result_that_is_broken_is_refused_before_any_work(content, run, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(work, "read_subject", None)
    broken = shutil.copytree(run, tmp_path / "run") / "suite-unseen.json"
    broken.write_text(content)
    for reference in (broken, broken.parent):
        assert_refused([reference], ["suite-unseen.json is not the result of a suite"], capsys)
    assert not (broken.parent / "report.html").exists()


# ---- bags


@pytest.fixture(scope="module")
def bag(run, tmp_path_factory) -> Path:
    """A drive of a few steps."""
    pytest.importorskip("rosbags")
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    import_module("tb2rl.play").main([str(run), "--steps", "3", "--bag", str(path)])
    return path


def test_a_bag_has_a_page_of_its_own_in_the_world_that_is_named(bag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hall.txt").write_text("#######\n#.S...#\n#######\n")
    report.main([str(bag), "--world", "{file: hall.txt}", "--topics", "odom=/ground_truth"])
    assert "report.html: 1 drive, " in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert [part for part in ("<title>drive.bag</title>", "in hall", "odom: /ground_truth") if part not in page] == []


def test_a_bag_can_stand_on_the_page_of_a_run(run, bag, tmp_path, capsys):
    report.main([str(run), str(bag), "--out", str(tmp_path / "it.html")])
    assert "it.html: 1 run, 1 drive, " in capsys.readouterr().out


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
        ("file", ["file is not the result of a suite"]),
        ("zoo:missing", ["unknown zoo policy", "maze-loop-qlearn"]),
        ("missing.bag", ["there is no bag missing.bag"]),
    ],
)
def test_what_is_not_a_run_is_refused(reference, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert_refused([reference], named, capsys)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--world", "lop"], ["unknown world 'lop'", "did you mean 'loop'"]),
        (["--world", "[loop, circuit]"], ["--world takes one world, got 2"]),
        (["--world", "1"], ["--world", "must be a name"]),
        (["--world", "[1"], ["--world is not YAML"]),
        (["--topics", "odometry=/odom"], ["unknown kind of topic 'odometry'", "odom"]),
        (["--topics", "/odom"], ["KIND=NAME", "/odom"]),
        (["--topics", "scan=/odom"], ["no topic /odom of type sensor_msgs", "/kobuki/laser/scan"]),
    ],
)
def test_what_does_not_fit_a_bag_is_refused(more, named, bag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert_refused([bag, *more], named, capsys)
    assert list(tmp_path.iterdir()) == []


def test_what_is_said_of_bags_wants_a_bag(run, capsys):
    for more in (["--world", "loop"], ["--topics", "odom=/odom"]):
        assert_refused([run, *more], ["--topics and --world are for bags"], capsys)


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
