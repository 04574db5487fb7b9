"""The command `report`: the page's path, the printed line, and one line for arguments that do not fit."""

import re
import shutil
from importlib import import_module
from pathlib import Path

import pytest

from tb2rl import report, train
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
def test_a_zoo_policy_has_a_page_too_and_a_terminal_shows_bars(workdir, terminal):
    stream = terminal()
    report.main(["zoo:wall-wall-qlearn"])  # its recipe names settings that are default now
    assert "zoo:wall-wall-qlearn" in (workdir / "report.html").read_text(encoding="utf-8")
    assert [bar for bar in ("reading:", "drawing:") if bar not in stream.getvalue()] == []


@pytest.mark.slow
def test_suite_results_are_on_the_page_of_their_run_and_have_pages_of_their_own(unseen, workdir, capsys):
    settings = {"task.world": "loop", "task.named_actions": True, "task.observe": ["goal"]}
    short = {"total_timesteps": 8, "n_envs": 1, "eval_freq": 0, "save_freq": 0}
    train("qlearn", "navigate", settings=settings, folder="navigator", **short)
    import_module("tb2rl.evaluate").main(["navigator", "--suite", "unseen", "--workers", "1"])
    report.main(["navigator"])
    assert ": 1 run, 1 suite, " in capsys.readouterr().out
    page = (workdir / "navigator" / "report.html").read_text(encoding="utf-8")
    assert [name for name in ("runs", "evaluation", "suite-1") if f'id="{name}"' not in page] == []
    assert page.count("<canvas") == 6, "three of the run, three of the suite"
    moved = Path("navigator").rename("moved")  # the policy is found beside the result
    report.main(["moved/suite-unseen.json", str(moved.absolute() / "suite-unseen.json")])
    assert "report.html: 1 suite, " in capsys.readouterr().out
    page = (workdir / "report.html").read_text(encoding="utf-8")
    assert 'id="runs"' not in page
    assert page.count("<canvas") == 3


def test_a_bag_has_a_page_of_its_own_or_is_on_the_page_of_a_run(trained_run, bag, workdir, capsys):
    (workdir / "hall.txt").write_text("#######\n#.S...#\n#######\n")
    report.main([str(bag), "--world", "{file: hall.txt}", "--topics", "odom=/ground_truth"])
    assert "report.html: 1 bag, " in capsys.readouterr().out
    page = (workdir / "report.html").read_text(encoding="utf-8")
    assert [part for part in ("<title>drive.bag</title>", "in hall", "odom: /ground_truth") if part not in page] == []
    report.main([str(trained_run), str(bag), "--out", "it.html"])
    assert "it.html: 1 run, 1 bag, " in capsys.readouterr().out


def test_a_bag_is_compared_with_a_simulation_of_its_robot(workdir, capsys):
    pytest.importorskip("rosbags")
    options = ["--steps", "50", "--simulation", "kinematic", "--set", "task.variation={wheel_radius: 1.02}"]
    import_module("tb2rl.play").main(["zoo:drive-loop-ppo", *options, "--bag", "it.bag"])
    mine = "robot: {base: turtlebot2}\nvariation: {wheel_radius: 1.02}\nlatency: [0.004, 0.006]\n"  # not a control step
    (workdir / "mine.yaml").write_text(mine)
    capsys.readouterr()
    distances = []
    for against in ("mine.yaml", "zoo:drive-loop-ppo"):
        report.main(["it.bag", "--against", against, "--world", "loop"])
        line, _ = capsys.readouterr().out.splitlines()
        assert line.startswith(f"it.bag against {against}: 0.")
        assert "ranges 0." in line
        distances.append([float(number) for number in re.findall(r"[0-9.]+(?= m and| degrees)", line)])
        assert f"with the robot of {against}" in " ".join((workdir / "report.html").read_text().split())
    (distance, turn), (other_distance, _) = distances
    assert distance < other_distance  # in another simulator
    assert turn < 2.0


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("missing", ["no run folder missing"]),
        ("zoo:missing", ["unknown zoo policy", "maze-loop-qlearn"]),
        ("missing.bag", ["there is no bag missing.bag"]),
        ("suite-unseen.json", ["suite-unseen.json is not the result of a suite"]),
        ("zoo:maze-loop-ppo --world loop", ["--world is for bags"]),
        ("zoo:maze-loop-ppo --against zoo:maze-loop-ppo", ["--against is for bags"]),
        ("BAG --against missing.yaml", ["missing.yaml"]),
        ("BAG --against zoo:maze-loop-ppo", ["shorter than a window of 6 s"]),
        ("zoo:maze-loop-ppo --out missing/it.html", ["cannot write missing/it.html"]),
        ("zoo:maze-loop-ppo --out .", ["cannot write ."]),
        ("BAG --world '[loop, circuit]'", ["--world takes one world, got 2"]),
        ("BAG --world [1", ["cannot parse --world as YAML"]),
        ("BAG --topics scan=/odom", ["no topic /odom of type sensor_msgs", "/kobuki/laser/scan"]),
    ],
)
def test_arguments_that_do_not_fit_are_refused(line, named, bag, workdir, refused):
    (workdir / "suite-unseen.json").write_text('{"failure_free_rate": 1.0}')
    refused(report.main, line.replace("BAG", str(bag)), named)
