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


@pytest.fixture(autouse=True)
def short_evaluations(workdir, monkeypatch) -> None:
    """Evaluations that are made for the page: one episode."""
    monkeypatch.setattr(run_views, "_EPISODES", 1)


@pytest.fixture(scope="module")
def bag(trained_run, tmp_path_factory) -> Path:
    """A drive of a few steps."""
    pytest.importorskip("rosbags")
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    import_module("tb2rl.play").main([str(trained_run), "--steps", "3", "--bag", str(path)])
    return path


def test_the_page_of_one_run_is_in_its_folder_and_its_path_is_printed(trained_run, workdir, capsys):
    shutil.copytree(trained_run, workdir / "run")
    report.main(["run"])
    out, err = capsys.readouterr()
    page = Path("run/report.html")
    assert out == f"{page}: 1 run, {page.stat().st_size / 1e6:.1f} MB\n"
    assert err == "", "no bars where there is no terminal"
    assert page.read_text(encoding="utf-8").lstrip().startswith("<!DOCTYPE html>")


@pytest.mark.slow
def test_a_zoo_policy_has_a_page_too_and_a_terminal_shows_bars(workdir, monkeypatch, capsys):
    stream = StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    report.main(["zoo:maze-loop-ppo"])
    assert "zoo:maze-loop-ppo" in (workdir / "report.html").read_text(encoding="utf-8")
    assert [bar for bar in ("reading:", "drawing:") if bar not in stream.getvalue()] == []
    assert capsys.readouterr().out.count("\n") == 1


@pytest.mark.slow
def test_suite_results_are_on_the_page_of_their_run_and_have_pages_of_their_own(
    small_suite, workdir, monkeypatch, capsys
):
    settings = {"task.world": "loop", "task.named_actions": True, "task.observe": ["goal"]}
    short = {"total_timesteps": 8, "n_envs": 1, "eval_freq": 0, "save_freq": 0}
    train("qlearn", "navigate", settings=settings, folder="navigator", **short)
    for module in (import_module("tb2rl.commands.suite"), suites):
        monkeypatch.setattr(module, "find_suite", lambda name, path: small_suite(name))
    import_module("tb2rl.evaluate").main(["navigator", "--suite", "unseen", "--workers", "1"])
    report.main(["navigator"])
    assert ": 1 run, 1 suite, " in capsys.readouterr().out
    page = (workdir / "navigator" / "report.html").read_text(encoding="utf-8")
    assert [name for name in ("runs", "evaluation", "suite-1") if f'id="{name}"' not in page] == []
    assert page.count("data:image/gif") == 3
    moved = Path("navigator").rename("moved")  # the policy is found beside the result
    report.main(["moved/suite-unseen.json", str(moved.absolute() / "suite-unseen.json")])
    assert "report.html: 1 suite, " in capsys.readouterr().out
    page = (workdir / "report.html").read_text(encoding="utf-8")
    assert 'id="runs"' not in page
    assert page.count("data:image/gif") == 3


def test_a_bag_has_a_page_of_its_own_or_is_on_the_page_of_a_run(trained_run, bag, workdir, capsys):
    (workdir / "hall.txt").write_text("#######\n#.S...#\n#######\n")
    report.main([str(bag), "--world", "{file: hall.txt}", "--topics", "odom=/ground_truth"])
    assert "report.html: 1 drive, " in capsys.readouterr().out
    page = (workdir / "report.html").read_text(encoding="utf-8")
    assert [part for part in ("<title>drive.bag</title>", "in hall", "odom: /ground_truth") if part not in page] == []
    report.main([str(trained_run), str(bag), "--out", "it.html"])
    assert "it.html: 1 run, 1 drive, " in capsys.readouterr().out


@pytest.mark.parametrize("content", ['{"failure_free_rate": 1.0}', "[1, 2"])
def test_a_damaged_result_is_refused_before_any_work(content, trained_run, workdir, monkeypatch, refused):
    monkeypatch.setattr(report_command, "read_run_view", None)
    damaged = shutil.copytree(trained_run, workdir / "run") / "suite-unseen.json"
    damaged.write_text(content)
    for reference in (damaged, damaged.parent):
        refused(report.main, [str(reference)], ["suite-unseen.json is not the result of a suite"])


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("missing", ["no run folder missing"]),
        ("file", ["file is not the result of a suite"]),
        ("zoo:missing", ["unknown zoo policy", "maze-loop-qlearn"]),
        ("missing.bag", ["there is no bag missing.bag"]),
        (300 * "r", ["too long", "rrr"]),
        ("zoo:maze-loop-ppo --world loop", ["--topics and --world are for bags"]),
        ("BAG --world lop", ["unknown world 'lop'", "did you mean 'loop'"]),
        ("BAG --world '[loop, circuit]'", ["--world takes one world, got 2"]),
        ("BAG --world 1", ["--world", "must be a name"]),
        ("BAG --world [1", ["--world is not YAML"]),
        ("BAG --topics odometry=/odom", ["unknown kind of topic 'odometry'", "odom"]),
        ("BAG --topics scan=/odom", ["no topic /odom of type sensor_msgs", "/kobuki/laser/scan"]),
    ],
)
def test_arguments_that_do_not_fit_are_refused(line, named, bag, workdir, refused):
    (workdir / "file").touch()
    refused(report.main, line.replace("BAG", str(bag)), named)


@pytest.mark.parametrize("out", ["missing/it.html", ".", "locked/it.html", f"{300 * 'r'}/it.html"])
def test_a_page_that_cannot_be_written_is_refused_before_any_work(out, trained_run, workdir, monkeypatch, refused):
    if out.startswith("locked") and os.geteuid() == 0:
        pytest.skip("root can write anywhere")
    (workdir / "locked").mkdir(mode=0o500)
    monkeypatch.setattr(report_command, "read_run_view", None)
    refused(report.main, [str(trained_run), "--out", out], ["too long" if len(out) > 255 else "cannot write"])


def test_a_full_disk_is_one_line(trained_run, monkeypatch, refused):
    def fail(path, text):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(report_command, "page", lambda *_, **__: "")
    monkeypatch.setattr(report_command, "write_text", fail)
    refused(report.main, [str(trained_run), "--out", "it.html"], ["cannot write", "it.html", "No space left"])
