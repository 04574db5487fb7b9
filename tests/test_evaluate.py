"""The command `evaluate`: its table, and the files that it writes."""

import json
import shutil
from importlib import import_module

import pytest

from tb2rl import evaluate, load
from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluate import SEED
from tb2rl.evaluation.evaluation import load_evaluation
from tb2rl.runs.folder import Run
from tb2rl.simulation.simulator import default_physics

work = import_module("tb2rl.commands.evaluate")
command = import_module("tb2rl.evaluate")  # `from tb2rl import evaluate` is the function
KEYS = {"failure_free_rate", "success_rate", "mean_distance", "mean_return", "mean_length", "episodes"}


@pytest.fixture
def run(trained_run, tmp_path):
    """A run folder without evaluations."""
    return shutil.copytree(trained_run, tmp_path / "run")


@pytest.fixture
def short(monkeypatch):
    """Arguments for a standard evaluation of two episodes of five steps in this process."""
    for module in (work, import_module("tb2rl.evaluation.evaluate")):
        monkeypatch.setattr(module, "EPISODES", 2)
    monkeypatch.setattr(work, "STEPS", 5)
    return ["--workers", "1"]


def test_the_standard_evaluation_is_written_into_the_run_folder(run, short, capsys):
    command.main([str(run), *short])
    written = json.loads((run / "evaluation.json").read_text())
    assert written.keys() >= KEYS | {"policy", "config", "versions"}
    assert (written["episodes"], written["steps"], written["seed"], len(written["each"])) == (2, 5, SEED, 2)
    assert (written["policy"], written["simulation"]) == (str(run), default_physics().name)
    assert written["config"] == load(run).trained_with.to_dict()
    shown = capsys.readouterr().out
    assert f"{100 * written['failure_free_rate']:.1f} %" in shown
    assert f"{written['mean_return']:.1f}" in shown
    assert f"not {default_physics().title}'s" not in shown
    assert load_evaluation(Run.open(run)).summary() == evaluate(run, episodes=2, steps=5, workers=1).summary()
    for file in ("evaluation.json", "episodes.safetensors"):
        (run / file).unlink()
    with pytest.raises(InputError, match="no standard evaluation: run"):
        load_evaluation(Run.open(run))


@pytest.mark.parametrize("change", [[], ["--episodes", "3"], ["--set", "task.world=circuit"]])
def test_any_other_evaluation_is_not_written_into_the_run_folder(change, run, short, capsys):
    simulation = [] if change else ["--simulation", "kinematic"]
    command.main([str(run), *short, *simulation, *change])
    assert not (run / "evaluation.json").exists()
    shown = capsys.readouterr().out
    assert "not written: only a run folder's standard evaluation" in shown
    assert (f"not {default_physics().title}'s" in shown) == bool(simulation)


def test_a_policy_of_the_zoo_is_evaluated_by_its_name_at_a_changed_task(short, tmp_path, capsys):
    changes = ["--set", "task.world=circuit", "task.laser_noise=0.1", "--set", "task.forward_speed=0.1"]
    command.main(["zoo:maze-loop-qlearn", *short, "--json", str(tmp_path / "it.json"), *changes])
    title = f"zoo:maze-loop-qlearn in circuit, {default_physics().title}"
    assert capsys.readouterr().out.splitlines()[0].strip() == title
    written = json.loads((tmp_path / "it.json").read_text())
    task = written["config"]["task"]
    assert (task["world"], task["laser_noise"], task["forward_speed"]) == ("circuit", 0.1, 0.1)
    assert written["policy"] == "zoo:maze-loop-qlearn"


def test_a_baseline_is_evaluated_by_its_name_at_another_task(short, tmp_path, capsys):
    command.main(["--agent", "wallfollower", "--task", "wall", *short, "--json", str(tmp_path / "it.json")])
    written = json.loads((tmp_path / "it.json").read_text())
    assert (written["policy"], written["config"]["task"]["name"]) == ("wallfollower", "wall")
    assert "goal reached" in capsys.readouterr().out


def test_all_physics_simulators_are_compared_in_the_same_episodes(run, short, referees, capsys):
    command.main([str(run), *short, "--simulation", "all"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "run in loop, 2 episodes of at most 5 steps" in shown
    assert "First ┃ Second" in shown
    assert "Second - First: 0.0 points (95 % interval -65.8 to 65.8), paired over 2 episodes" in shown
    written = json.loads((run / "evaluation.json").read_text())
    first, second = written["by_simulation"].values()
    assert (written["simulation"], first["simulation"], second["simulation"]) == ("first", "first", "second")
    assert {key: written[key] for key in KEYS} == {key: first[key] for key in KEYS}
    assert first["mean_distance"] != second["mean_distance"]
    assert (second["difference"], len(second["difference_interval"])) == (0.0, 2)
    assert load_evaluation(Run.open(run)).summary()["mean_distance"] == first["mean_distance"]


def test_a_missing_second_physics_is_a_line_and_the_evaluation_goes_on(run, short, referees, capsys):
    referees("Second", available=False)
    command.main([str(run), *short, "--simulation", "all"])
    shown = "".join(capsys.readouterr().out.split())  # the title wraps where the path of the run is long
    assert "notinallphysicssimulators:Secondisnotinstalled" in shown
    assert "runinloop,First" in shown
    assert "by_simulation" not in json.loads((run / "evaluation.json").read_text())


@pytest.mark.parametrize(
    ("arguments", "starts"), [([], 1), (["--workers", "1"], 0), (["--simulation", "kinematic"], 0)]
)
def test_the_fork_server_starts_before_the_slow_imports_if_there_will_be_workers(arguments, starts, monkeypatch):
    calls = []
    monkeypatch.setattr("tb2rl.core.command.processors", lambda: 2)
    monkeypatch.setattr("tb2rl.core.command.process_context", lambda: calls.append("start"))
    monkeypatch.setattr("tb2rl.core.command.import_object", lambda reference: lambda options: calls.append(reference))
    command.main(["zoo:maze-loop-ppo", *arguments])
    assert calls == ["start"] * starts + ["tb2rl.commands.evaluate:run"]


def test_the_safety_filter_drives_with_any_policy_and_its_share_is_shown(capsys):
    settings = "--set task.collision_range=0 task.beams=37"
    arguments = f"--agent random --task drive --simulation kinematic --episodes 2 --steps 40 {settings}"
    command.main([*arguments.split(), "--safe", "guaranteed"])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "changed by filters" in line]
    assert "% of steps" in line
    command.main(arguments.split())
    assert "filters" not in capsys.readouterr().out


def test_the_safety_filter_refuses_a_laser_with_few_beams(refused):
    line = "--agent random --set task.beams=9 --safe"
    refused(command.main, line, ["task.filters.Safety", "a laser beam at least every 5.5 degrees"])
