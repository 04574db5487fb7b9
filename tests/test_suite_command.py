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
WORLD = ["--set", "task.world=loop"]
RANDOM = ["--agent", "random", "--task", "navigate", *WORLD, "--workers", "1"]


@pytest.fixture
def suite(small_suite, monkeypatch) -> list[str]:
    """Arguments for `unseen`, which has three small worlds here."""
    monkeypatch.setattr(work, "find_suite", lambda name, path: small_suite(name))
    return ["--suite", "unseen"]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run folder with a policy for navigation that has learned next to nothing."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    settings = {"task.world": "loop", "task.named_actions": True, "task.observe": ["goal"]}
    train(
        "qlearn", "navigate", settings=settings, total_timesteps=50, n_envs=1, eval_freq=0, save_freq=0, folder=folder
    )
    return folder


@pytest.fixture
def interrupt(driven, monkeypatch):
    """A function that runs the command and interrupts it by Ctrl-C after a number of worlds."""
    drives_of = work.drives_of

    def run(arguments: list[str], worlds: int) -> None:
        def interrupted(*those):
            yield from islice(drives_of(*those), worlds)
            raise KeyboardInterrupt

        with monkeypatch.context() as patched:
            patched.setattr(work, "drives_of", interrupted)
            assert ended(arguments) == 130

    return run


def ended(arguments: list[str]) -> object:
    """The exit status of the command."""
    with pytest.raises(SystemExit) as stopped:
        command.main(arguments)
    return stopped.value.code


# ---- where the result goes


def test_the_result_at_the_task_of_the_training_is_written_into_the_run_folder(run, suite, capsys):
    command.main([str(run), *suite, "--workers", "1"])
    written = json.loads((run / "suite-unseen.json").read_text())
    assert written["figures"]["all"]["worlds"] == 3
    assert written["figures"].keys() == {"all", "a", "b"}
    assert written["policy"] == str(run)
    assert len(written["policy_digest"]) == 64
    assert not (run / "suite-unseen.json.journal").exists()
    (run / "suite-unseen.json").unlink()
    shown = " ".join(capsys.readouterr().out.split())
    assert "guide goal, turtlebot2, PyBullet: suite unseen" in shown
    assert f"{100 * written['figures']['all']['success_rate']:.1f} %" in shown
    assert "│ a │ 2 │" in shown


def test_the_result_at_another_task_is_not_written_into_the_run_folder(run, suite, capsys):
    command.main([str(run), *suite, "--workers", "1", "--set", "task.laser_noise=0.1"])
    assert list(run.glob("suite*")) == []
    assert "not kept: a run folder" in capsys.readouterr().out


def test_json_is_written_to_the_named_file(suite, tmp_path, capsys):
    command.main([*RANDOM, *suite, "--json", str(tmp_path / "it.json")])
    written = json.loads((tmp_path / "it.json").read_text())
    assert (written["policy"], written["policy_digest"]) == ("agent random", None)
    assert [each["world"] for each in written["each"]] == [0, 1, 2]
    assert [file.name for file in tmp_path.iterdir()] == ["it.json"]
    assert capsys.readouterr().out.startswith("agent random, guide goal, turtlebot2, PyBullet: suite unseen")


def test_saving_a_better_policy_removes_the_result(run, suite):
    command.main([str(run), *suite, "--workers", "1"])
    opened = Run.open(run)
    place = opened.policy_file.relative_to(run).with_suffix("")
    assert opened.suite_file("unseen").is_file()
    opened.save(load(run), str(place))
    assert not opened.suite_file("unseen").exists()


# ---- an interrupted suite


def test_an_interrupted_suite_continues_and_gives_the_same_result(suite, interrupt, driven, tmp_path, capsys):
    arguments = [*RANDOM, *suite, "--json"]
    command.main([*arguments, str(tmp_path / "whole.json")])
    interrupt([*arguments, str(tmp_path / "parts.json")], 2)
    assert not (tmp_path / "parts.json").exists()
    with (tmp_path / "parts.json.journal").open("a") as stream:
        stream.write('{"world": 2, "end')  # as if killed while writing
    interrupt([*arguments, str(tmp_path / "parts.json")], 0)
    assert driven == [0, 1, 2, 0, 1]
    command.main([*arguments, str(tmp_path / "parts.json")])
    assert driven == [0, 1, 2, 0, 1, 2]
    assert (tmp_path / "parts.json").read_bytes() == (tmp_path / "whole.json").read_bytes()
    assert "continuing: 2 of 3 worlds" in capsys.readouterr().out
    assert not (tmp_path / "parts.json.journal").exists()


def test_a_journal_of_another_policy_task_or_suite_is_dropped(
    suite, small_suite, interrupt, driven, run, tmp_path, monkeypatch
):
    folder, file = tmp_path / "run", ["--json", str(tmp_path / "it.json")]
    shutil.copytree(run, folder)
    here = [str(folder), *suite, *file, "--workers", "1"]

    def driven_again(arguments: list[str]) -> list[int]:
        """The worlds driven until an interruption after two."""
        driven.clear()
        interrupt(arguments, 2)
        return driven.copy()

    assert driven_again([*RANDOM, *suite, *file]) == [0, 1]
    assert driven_again(here) == [0, 1], "another policy"
    assert driven_again([*here, "--set", "task.laser_noise=0.1"]) == [0, 1], "another task"
    assert driven_again(here) == [0, 1]
    place = str(Run.open(folder).policy_file.relative_to(folder).with_suffix(""))
    Run.open(folder).save(load(folder), place, more=1)
    assert driven_again(here) == [0, 1], "a policy of the same name"
    monkeypatch.setattr(work, "find_suite", lambda name, path: small_suite(last=1.1))
    assert driven_again(here) == [0, 1], "another suite of the same name"
    assert driven_again(here) == [2], "the same"


def refused(capsys, arguments: list[str]) -> str:
    status, message = ended(arguments), capsys.readouterr().err
    assert (status, message.count("\n")) == (2, 1), message
    return message


@pytest.mark.parametrize("line", ['{"world": 5}', '{"world": 0, "time": "long"}', "7"])
def test_a_damaged_journal_is_refused(line, suite, interrupt, tmp_path, capsys):
    arguments = [*RANDOM, *suite, "--json", str(tmp_path / "it.json")]
    interrupt(arguments, 0)
    with (tmp_path / "it.json.journal").open("a") as stream:
        stream.write(line + "\n")
    assert "it.json.journal" in refused(capsys, arguments)


# ---- what does not fit


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--suite", "unsen"], "did you mean 'unseen'"),
        (["--suite", "barn"], "barn PATH"),
        (["--suite", "barn", "missing.npz"], "missing.npz"),
        (["--suite", "barn", "text.npz"], "text.npz is not an .npz file"),
        (["--suite", "barn", "."], "no folder path_files"),
        (["--suite", "unseen", "one", "two"], "name the policy before it"),
        (["--suite", "unseen", "--episodes", "3"], "--episodes does not go with --suite"),
        (["--suite", "unseen", "--set", "task.episode_steps=60"], "task.episode_steps does not go with --suite"),
        (["--suite", "unseen", "--goal", "3,2"], "--goal does not go with --suite"),
        (["--suite", "unseen", "--simulation", "ros"], "--simulation does not go with --suite"),
        (["--suite", "unseen", "--top-speed", "0.3"], "go with --simulation ros"),
    ],
)
def test_contradicting_options_are_refused(options, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.npz").write_text("no archive")
    assert named in refused(capsys, [*RANDOM, *options])
    assert [file.name for file in tmp_path.iterdir()] == ["text.npz"]


def test_a_task_without_goals_is_refused(suite, capsys):
    assert "such as navigate" in refused(capsys, ["--agent", "random", *suite])
