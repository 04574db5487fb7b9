"""The command `evaluate --suite`: its result files, and how an interrupted suite continues."""

from __future__ import annotations

import json
import shutil
from importlib import import_module
from itertools import islice
from pathlib import Path

import pytest

from tb2rl import load, train
from tb2rl.runs.folder import Run

work = import_module("tb2rl.commands.suite")
command = import_module("tb2rl.evaluate")  # `from tb2rl import evaluate` is the function
RANDOM = ["--agent", "random", "--task", "navigate", "--set", "task.world=loop", "--workers", "1"]


@pytest.fixture
def suite(small_suite, monkeypatch) -> list[str]:
    """Arguments for `unseen`, which has three small worlds here."""
    monkeypatch.setattr(work, "find_suite", lambda name, path: small_suite(name))
    return ["--suite", "unseen"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """A run folder with a policy for navigation that has learned next to nothing."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    settings = {"task.world": "loop", "task.named_actions": True, "task.observe": ["goal"]}
    short = {"total_timesteps": 50, "n_envs": 1, "eval_freq": 0, "save_freq": 0, "simulation": "kinematic"}
    train("qlearn", "navigate", settings=settings, folder=folder, **short)
    return folder


@pytest.fixture
def run(trained, tmp_path) -> Path:
    """A copy of the run folder, to write to."""
    return shutil.copytree(trained, tmp_path / "run")


@pytest.fixture
def interrupt(driven, monkeypatch):
    """A function that runs the command, interrupts it by Ctrl-C after some worlds, and returns the worlds driven."""
    drives_of = work.drives_of

    def run(arguments: list[str], worlds: int) -> list[int]:
        def interrupted(*those):
            yield from islice(drives_of(*those), worlds)
            raise KeyboardInterrupt

        driven.clear()
        with monkeypatch.context() as patched:
            patched.setattr(work, "drives_of", interrupted)
            with pytest.raises(SystemExit) as stopped:
                command.main(arguments)
        assert stopped.value.code == 130
        return driven.copy()

    return run


def test_the_result_at_the_task_of_the_training_is_written_into_the_run_folder(run, suite, capsys):
    command.main([str(run), *suite, "--workers", "1"])
    written = json.loads((run / "suite-unseen.json").read_text())
    assert written["figures"]["all"]["worlds"] == 3
    assert written["figures"].keys() == {"all", "a", "b"}
    assert (written["policy"], len(written["policy_digest"])) == (str(run), 64)
    assert not (run / "suite-unseen.json.journal").exists()
    shown = " ".join(capsys.readouterr().out.split())
    assert "guide goal, turtlebot2, PyBullet: suite unseen" in shown
    assert f"{100 * written['figures']['all']['success_rate']:.1f} %" in shown
    assert "│ a │ 2 │" in shown
    opened = Run.open(run)
    opened.save(load(run), str(opened.policy_file.relative_to(run).with_suffix("")))
    assert not opened.suite_file("unseen").exists(), "it was of the policy before"


def test_the_result_at_another_task_is_not_written_into_the_run_folder(run, suite, capsys):
    command.main([str(run), *suite, "--workers", "1", "--set", "task.laser_noise=0.1"])
    assert list(run.glob("suite*")) == []
    assert "not kept: a run folder" in capsys.readouterr().out


def test_an_interrupted_suite_continues_and_gives_the_same_result(suite, interrupt, driven, workdir, capsys):
    arguments = [*RANDOM, *suite, "--json"]
    command.main([*arguments, "whole.json"])
    assert capsys.readouterr().out.startswith("agent random, guide goal, turtlebot2, PyBullet: suite unseen")
    assert [file.name for file in workdir.iterdir()] == ["whole.json"]
    written = json.loads((workdir / "whole.json").read_text())
    assert (written["policy"], written["policy_digest"]) == ("agent random", None)
    assert interrupt([*arguments, "parts.json"], 2) == [0, 1]
    assert not (workdir / "parts.json").exists()
    with (workdir / "parts.json.journal").open("a") as stream:
        stream.write('{"world": 2, "end')  # as if killed while writing
    assert interrupt([*arguments, "parts.json"], 0) == []
    command.main([*arguments, "parts.json"])
    assert driven == [2]
    assert (workdir / "parts.json").read_bytes() == (workdir / "whole.json").read_bytes()
    assert "continuing: 2 of 3 worlds" in capsys.readouterr().out
    assert not (workdir / "parts.json.journal").exists()


def test_a_journal_of_another_policy_task_or_suite_is_dropped(suite, small_suite, interrupt, run, workdir, monkeypatch):
    file = ["--json", "it.json"]
    here = [str(run), *suite, *file, "--workers", "1"]
    assert interrupt([*RANDOM, *suite, *file], 2) == [0, 1]
    assert interrupt(here, 2) == [0, 1], "another policy"
    assert interrupt([*here, "--set", "task.laser_noise=0.1"], 2) == [0, 1], "another task"
    assert interrupt(here, 2) == [0, 1]
    Run.open(run).save(load(run), str(Run.open(run).policy_file.relative_to(run).with_suffix("")), more=1)
    assert interrupt(here, 2) == [0, 1], "a policy of the same name"
    monkeypatch.setattr(work, "find_suite", lambda name, path: small_suite(last=1.1))
    assert interrupt(here, 2) == [0, 1], "another suite of the same name"
    assert interrupt(here, 2) == [2], "the same"


@pytest.mark.parametrize("line", ['{"world": 5}', '{"world": 0, "time": "long"}', "7"])
def test_a_damaged_journal_is_refused(line, suite, interrupt, workdir, refused):
    arguments = [*RANDOM, *suite, "--json", "it.json"]
    interrupt(arguments, 0)
    with (workdir / "it.json.journal").open("a") as stream:
        stream.write(line + "\n")
    refused(command.main, arguments, ["it.json.journal"])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--suite unsen", "did you mean 'unseen'"),
        ("--suite barn", "barn PATH"),
        ("--suite barn missing.npz", "missing.npz"),
        ("--suite barn text.npz", "text.npz is not an .npz file"),
        ("--suite barn .", "no folder path_files"),
        ("--suite unseen one two", "name the policy before it"),
        ("--suite unseen --episodes 3", "--episodes does not go with --suite"),
        ("--suite unseen --set task.episode_steps=60", "task.episode_steps does not go with --suite"),
        ("--suite unseen --goal 3,2", "--goal does not go with --suite"),
        ("--suite unseen --simulation kinematic", "--simulation does not go with --suite"),
        ("--suite unseen --top-speed 0.3", "go with --simulation ros"),
    ],
)
def test_contradicting_options_are_refused(options, named, workdir, refused):
    (workdir / "text.npz").write_text("no archive")
    refused(command.main, [*RANDOM, *options.split()], [named])


def test_a_task_without_goals_is_refused(suite, refused):
    refused(command.main, ["--agent", "random", *suite], ["such as navigate"])
