"""The command `report`: the page's path, the printed line, and one line for arguments that do not fit."""

from __future__ import annotations

import os
import shutil
import sys
from importlib import import_module
from io import StringIO
from pathlib import Path

import pytest

from tb2rl import report, train
from tb2rl.commands import report as report_command
from tb2rl.evaluation import suites
from tb2rl.viz import run_views


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run folder with a hardly trained policy."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train("qlearn", total_timesteps=8, n_envs=1, eval_freq=0, folder=folder)
    return folder


@pytest.fixture(autouse=True)
def short_evaluations(monkeypatch) -> None:
    """Evaluations that are made for the page: one episode."""
    monkeypatch.setattr(run_views, "_EPISODES", 1)


def test_the_page_of_one_run_is_in_its_folder_and_its_path_is_printed(run, capsys):
    report.main([str(run)])
    out, err = capsys.readouterr()
    page = run / "report.html"
    assert out == f"{page}: 1 run, {page.stat().st_size / 1e6:.1f} MB\n"
    assert err == "", "no bars where there is no terminal"
    assert page.read_text(encoding="utf-8").lstrip().startswith("<!DOCTYPE html>")
    page.unlink()


@pytest.mark.slow
def test_a_zoo_policy_has_a_page_too_and_a_terminal_shows_bars(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    stream = StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    report.main(["zoo:maze-loop-ppo"])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "zoo:maze-loop-ppo" in page
    assert [bar for bar in ("reading:", "drawing:") if bar not in stream.getvalue()] == []
    assert capsys.readouterr().out.count("\n") == 1


# ---- suite results


@pytest.fixture
def navigator(small_suite, monkeypatch, tmp_path) -> Path:
    """A run folder with a result of the suite `unseen`, here three small worlds."""
    folder = tmp_path / "navigator"
    settings = {"task.world": "loop", "task.named_actions": True, "task.observe": ["goal"]}
    train("qlearn", "navigate", settings=settings, total_timesteps=8, n_envs=1, eval_freq=0, save_freq=0, folder=folder)
    for module in (import_module("tb2rl.commands.suite"), suites):
        monkeypatch.setattr(module, "find_suite", lambda name, path: small_suite(name))
    import_module("tb2rl.evaluate").main([str(folder), "--suite", "unseen", "--workers", "1"])
    return folder


@pytest.mark.slow
def test_suite_results_are_on_the_page_of_their_run_and_have_pages_of_their_own(
    navigator, tmp_path, monkeypatch, capsys
):
    report.main([str(navigator)])
    assert ": 1 run, 1 suite, " in capsys.readouterr().out
    page = (navigator / "report.html").read_text(encoding="utf-8")
    assert [name for name in ("runs", "evaluation", "suite-1") if f'id="{name}"' not in page] == []
    assert page.count("data:image/gif") == 3
    moved = navigator.rename(tmp_path / "moved")  # the policy is found beside the result
    monkeypatch.chdir(tmp_path)
    report.main(["moved/suite-unseen.json", str(moved / "suite-unseen.json")])
    assert "report.html: 1 suite, " in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert 'id="runs"' not in page
    assert page.count("data:image/gif") == 3


@pytest.mark.parametrize("content", ['{"failure_free_rate": 1.0}', "[1, 2"])
def test_a_damaged_result_is_refused_before_any_work(content, run, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(report_command, "read_run_view", None)
    damaged = shutil.copytree(run, tmp_path / "run") / "suite-unseen.json"
    damaged.write_text(content)
    for reference in (damaged, damaged.parent):
        assert_refused([reference], ["suite-unseen.json is not the result of a suite"], capsys)
    assert not (damaged.parent / "report.html").exists()


# ---- bags


@pytest.fixture(scope="module")
def bag(run, tmp_path_factory) -> Path:
    """A drive of a few steps."""
    pytest.importorskip("rosbags")
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    import_module("tb2rl.play").main([str(run), "--steps", "3", "--bag", str(path)])
    return path


def test_a_bag_has_a_page_of_its_own_or_is_on_the_page_of_a_run(run, bag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hall.txt").write_text("#######\n#.S...#\n#######\n")
    report.main([str(bag), "--world", "{file: hall.txt}", "--topics", "odom=/ground_truth"])
    assert "report.html: 1 drive, " in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert [part for part in ("<title>drive.bag</title>", "in hall", "odom: /ground_truth") if part not in page] == []
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
        ("file", ["file is not the result of a suite"]),
        ("zoo:missing", ["unknown zoo policy", "maze-loop-qlearn"]),
        ("missing.bag", ["there is no bag missing.bag"]),
        (300 * "r", ["too long", "rrr"]),
        ("zoo:maze-loop-ppo|--world|loop", ["--topics and --world are for bags"]),
    ],
)
def test_references_that_are_no_runs_are_refused(reference, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert_refused([*reference.split("|")], named, capsys)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--world", "lop"], ["unknown world 'lop'", "did you mean 'loop'"]),
        (["--world", "[loop, circuit]"], ["--world takes one world, got 2"]),
        (["--world", "1"], ["--world", "must be a name"]),
        (["--world", "[1"], ["--world is not YAML"]),
        (["--topics", "odometry=/odom"], ["unknown kind of topic 'odometry'", "odom"]),
        (["--topics", "scan=/odom"], ["no topic /odom of type sensor_msgs", "/kobuki/laser/scan"]),
    ],
)
def test_options_that_do_not_fit_a_bag_are_refused(options, named, bag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert_refused([bag, *options], named, capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", ["missing/it.html", ".", "locked/it.html", 300 * "r"])
def test_a_page_that_cannot_be_written_is_refused(out, run, tmp_path, monkeypatch, capsys):
    if out.startswith("locked") and os.geteuid() == 0:
        pytest.skip("root can write anywhere")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "locked").mkdir(mode=0o500)
    if len(out) < 300:
        monkeypatch.setattr(report_command, "read_run_view", None)  # before any work
        assert_refused([run, "--out", out], ["cannot write", out], capsys)
    else:
        assert_refused([run, "--out", out], ["too long", "rrr"], capsys)


def test_a_full_disk_is_one_line(run, tmp_path, monkeypatch, capsys):
    def fail(path, text):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(report_command, "page", lambda *_, **__: "")
    monkeypatch.setattr(report_command, "write_text", fail)
    assert_refused([run, "--out", tmp_path / "it.html"], ["cannot write", "it.html", "No space left"], capsys)
