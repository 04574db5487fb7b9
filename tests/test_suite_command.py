"""The command `evaluate --suite`: its result files, and how an interrupted suite continues."""

import json
from importlib import import_module
from itertools import islice
from pathlib import Path

import pytest

from tb2rl import load, train
from tb2rl.evaluation.suite_comparison import read_results
from tb2rl.evaluation.suites import SuiteResult
from tb2rl.runs.folder import Run
from tb2rl.simulation.simulator import default_physics

work = import_module("tb2rl.commands.evaluate")
command = import_module("tb2rl.evaluate")  # `from tb2rl import evaluate` is the function
RANDOM = ["--agent", "random", "--task", "navigate", "--set", "task.world=loop", "--workers", "1"]
UNSEEN = ["--suite", "unseen"]  # which has three small worlds here

pytestmark = pytest.mark.usefixtures("unseen")


@pytest.fixture
def run(tmp_path) -> Path:
    """A run folder with a policy for navigation that has learned next to nothing."""
    folder = tmp_path / "run"
    settings = {"task.world": "loop", "task.named_actions": True, "task.observe": ["goal"]}
    short = {"total_timesteps": 50, "n_envs": 1, "eval_freq": 0, "save_freq": 0, "simulation": "kinematic"}
    train("qlearn", "navigate", settings=settings, folder=folder, **short)
    return folder


@pytest.fixture
def interrupt(driven, monkeypatch):
    """A function that runs the command, interrupts it by Ctrl-C after some worlds, and returns the worlds driven."""
    run_suite = work.run_suite

    def run(arguments: list[str], worlds: int) -> list[int]:
        def interrupted(*those):
            yield from islice(run_suite(*those), worlds)
            raise KeyboardInterrupt

        driven.clear()
        with monkeypatch.context() as patched:
            patched.setattr(work, "run_suite", interrupted)
            with pytest.raises(SystemExit) as stopped:
                command.main(arguments)
        assert stopped.value.code == 130
        return driven.copy()

    return run


def test_only_the_result_at_the_task_of_the_training_is_written_into_the_run_folder(run, capsys):
    command.main([str(run), *UNSEEN, "--workers", "1", "--set", "task.laser_noise=0.1"])
    assert list(run.glob("suite*")) == []
    assert "not written: only a run folder" in capsys.readouterr().out
    command.main([str(run), *UNSEEN, "--workers", "1"])
    written = json.loads((run / "suite-unseen.json").read_text())
    assert written["figures"].keys() == {"all", "a", "b"}
    assert (written["policy"], len(written["policy_digest"])) == (str(run), 64)
    assert list(run.glob("*.journal")) == []
    shown = " ".join(capsys.readouterr().out.split())
    assert f"guide goal, turtlebot2, {default_physics().title}: suite unseen" in shown
    assert f"{100 * written['figures']['all']['success_rate']:.1f} %" in shown
    assert "│ a │ 2 │" in shown
    opened = Run.open(run)
    opened.save(load(run), str(opened.policy_file.relative_to(run).with_suffix("")))
    assert not opened.suite_file("unseen").exists(), "it was of the policy before"


def test_an_interrupted_suite_continues_and_gives_the_same_result(interrupt, driven, workdir, capsys):
    arguments = [*RANDOM, *UNSEEN, "--json"]
    command.main([*arguments, "whole.json"])
    written = json.loads((workdir / "whole.json").read_text())
    assert (written["policy"], written["policy_digest"]) == ("agent random", None)
    assert interrupt([*arguments, "parts.json"], 2) == [0, 1]
    with (workdir / f"parts.json.{default_physics().name}.journal").open("a") as stream:
        stream.write('{"world": 2, "end')  # as if killed while writing
    assert interrupt([*arguments, "parts.json"], 0) == []
    command.main([*arguments, "parts.json"])
    assert driven == [2]
    assert (workdir / "parts.json").read_bytes() == (workdir / "whole.json").read_bytes()
    assert "continuing: 2 of 3 worlds" in capsys.readouterr().out
    assert sorted(file.name for file in workdir.iterdir()) == ["parts.json", "whole.json"]


def test_all_physics_simulators_have_a_result_and_an_interrupted_comparison_continues(
    referees, interrupt, driven, run, capsys
):
    arguments = [str(run), *UNSEEN, "--workers", "1", "--simulation", "all"]
    assert interrupt(arguments, 2) == [0, 1]
    assert [file.name for file in run.glob("suite*")] == ["suite-unseen.json.first.journal"]
    driven.clear()
    command.main(arguments)
    assert driven == [2, 0, 1, 2]
    assert [file.name for file in run.glob("suite*")] == ["suite-unseen.json"]
    tree = json.loads((run / "suite-unseen.json").read_text())["by_simulation"]
    assert tree.keys() == {"first", "second"}
    assert tree["first"]["unsuccessful_worlds"] == [0, 1, 2]
    assert (tree["second"]["difference"], "difference" in tree["first"]) == (0.0, False)
    shown = " ".join(capsys.readouterr().out.split())
    assert "turtlebot2, First and Second: suite unseen" in shown
    assert "│ a │ First │ 0.0 % │" in shown
    assert "│ a │ Second │ 0.0 % │" in shown
    assert "Second - First: 0.0 points (95 % interval -56.1 to 56.1), paired over 3 worlds" in shown
    assert [result.simulation for result in read_results(run / "suite-unseen.json")] == ["first", "second"]


def test_another_simulator_is_written_only_to_a_file_of_its_own(referees, run, workdir, capsys):
    arguments = [str(run), *UNSEEN, "--workers", "1", "--simulation", "second"]
    command.main(arguments)
    assert list(run.glob("suite*")) == []
    assert "not written: only a run folder's result without --set" in capsys.readouterr().out
    command.main([*arguments, "--json", "it.json"])
    assert SuiteResult.read(workdir / "it.json").simulation == "second"


def test_a_journal_of_another_policy_task_or_suite_is_dropped(small_suite, interrupt, run, workdir, monkeypatch):
    kept = [*UNSEEN, "--json", "it.json", "--workers", "1"]
    here = [str(run), *kept]
    assert interrupt([*RANDOM, *kept], 2) == [0, 1]
    assert interrupt(here, 2) == [0, 1], "another policy"
    assert interrupt([*here, "--set", "task.laser_noise=0.1"], 2) == [0, 1], "another task"
    assert interrupt(here, 2) == [0, 1]
    Run.open(run).save(load(run), str(Run.open(run).policy_file.relative_to(run).with_suffix("")), more=1)
    assert interrupt(here, 2) == [0, 1], "a policy of the same name"
    monkeypatch.setattr(work, "find_suite", lambda name, path: small_suite(last=1.1))
    assert interrupt(here, 2) == [0, 1], "another suite of the same name"
    assert interrupt(here, 2) == [2], "the same"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--suite unseen one two", "put the policy before --suite"),
        ("--suite unseen --episodes 3", "--episodes cannot be combined with --suite"),
        ("--suite unseen --set task.episode_steps=60", "task.episode_steps cannot be combined with --suite"),
        ("--suite unseen --top-speed 0.3", "needs --simulation ros"),
        ("--suite unseen --simulation ros", "--suite needs a simulator, but --simulation ros is a robot"),
        ("--suite unseen --simulation al", "unknown simulator 'al'"),
    ],
)
def test_contradicting_options_are_refused(options, named, refused):
    refused(command.main, [*RANDOM, *options.split()], [named])
