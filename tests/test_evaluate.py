"""The command `evaluate`: its table, and the files that it writes."""

from __future__ import annotations

import json
import shutil
import sys
from importlib import import_module
from io import StringIO

import pytest

from tb2rl import evaluate, load
from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import agent_names
from tb2rl.evaluation.evaluation import kept_evaluation
from tb2rl.evaluation.evaluator import SEED
from tb2rl.runs.folder import Run

work = import_module("tb2rl.commands.evaluate")
command = import_module("tb2rl.evaluate")  # `from tb2rl import evaluate` is the function
GUIDED = {"dwa", "pursuit", "vfh"}  # need a task with a goal: tests/agents
BASELINES = [name for name in agent_names() if find_agent(name).algorithm is None and name not in GUIDED]
KEYS = {"failure_free_rate", "success_rate", "mean_distance", "mean_return", "mean_length", "episodes"}


@pytest.fixture
def run(trained_run, tmp_path):
    """A run folder without evaluations."""
    return shutil.copytree(trained_run, tmp_path / "run")


@pytest.fixture
def short(monkeypatch):
    """Arguments for a standard evaluation of two episodes of five steps in this process."""
    monkeypatch.setattr(work, "EPISODES", 2)
    monkeypatch.setattr(work, "STEPS", 5)
    return ["--workers", "1"]


def test_the_standard_evaluation_is_written_into_the_run_folder(run, short, capsys):
    command.main([str(run), *short])
    written = json.loads((run / "evaluation.json").read_text())
    assert written.keys() >= KEYS | {"policy", "config", "versions"}
    assert (written["episodes"], written["steps"], written["seed"], len(written["each"])) == (2, 5, SEED, 2)
    assert (written["policy"], written["simulation"]) == (str(run), "bullet")
    assert written["config"] == load(run).trained_with.to_dict()
    again = evaluate(run, episodes=2, steps=5, workers=1)
    assert written["mean_return"] == again.summary()["mean_return"]
    shown = capsys.readouterr().out
    assert f"{100 * written['failure_free_rate']:.1f} %" in shown
    assert f"{written['mean_return']:.1f}" in shown
    assert "not PyBullet's" not in shown
    assert kept_evaluation(Run.open(run)).summary() == again.summary()
    for file in ("evaluation.json", "episodes.safetensors"):
        (run / file).unlink()
    with pytest.raises(InputError, match="no standard evaluation: run"):
        kept_evaluation(Run.open(run))


@pytest.mark.parametrize(
    "change", [[], ["--episodes", "3"], ["--steps", "4"], ["--seed", "1"], ["--set", "task.world=circuit"]]
)
def test_any_other_evaluation_is_not_written_into_the_run_folder(change, run, short, capsys):
    simulation = [] if change else ["--simulation", "kinematic"]
    command.main([str(run), *short, *simulation, *change])
    assert not (run / "evaluation.json").exists()
    shown = capsys.readouterr().out
    assert "not written: a run folder keeps its standard evaluation only" in shown
    assert ("not PyBullet's" in shown) == bool(simulation)


def test_json_and_settings_of_the_task(run, short, tmp_path, capsys):
    changes = ["--set", "task.world=circuit", "task.laser_noise=0.1", "--set", "task.forward_speed=0.1"]
    command.main([str(run), *short, "--json", str(tmp_path / "it.json"), *changes])
    written = json.loads((tmp_path / "it.json").read_text())
    task = written["config"]["task"]
    assert written.keys() >= KEYS
    assert (task["world"], task["laser_noise"], task["forward_speed"]) == ("circuit", 0.1, 0.1)
    assert "in circuit" in " ".join(capsys.readouterr().out.split()), "a long name of a folder breaks the title"
    assert not (run / "evaluation.json").exists()


def test_a_policy_of_the_zoo_is_evaluated_by_its_name(short, tmp_path, capsys):
    command.main(["zoo:maze-loop-qlearn", *short, "--json", str(tmp_path / "it.json")])
    assert capsys.readouterr().out.splitlines()[0].strip() == "zoo:maze-loop-qlearn in loop"
    assert json.loads((tmp_path / "it.json").read_text())["policy"] == "zoo:maze-loop-qlearn"


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_is_evaluated_by_its_name_at_another_task(name, short, tmp_path, capsys):
    command.main(["--agent", name, "--task", "wall", *short, "--json", str(tmp_path / "it.json")])
    written = json.loads((tmp_path / "it.json").read_text())
    assert (written["policy"], written["config"]["task"]["name"]) == (name, "wall")
    assert "goal reached" in capsys.readouterr().out


@pytest.mark.parametrize("is_terminal", [True, False])
def test_progress_is_drawn_on_a_terminal_only(is_terminal, run, short, monkeypatch, capsys):
    stream = StringIO()
    stream.isatty = lambda: is_terminal
    monkeypatch.setattr(sys, "stderr", stream)
    command.main([str(run), *short, "--simulation", "kinematic"])
    assert ("evaluating:" in stream.getvalue()) == is_terminal
    assert is_terminal or stream.getvalue() == ""
    assert "evaluating" not in capsys.readouterr().out
