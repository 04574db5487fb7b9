"""The benchmark of learning, `docs/benchmark`."""

import importlib
import json
import re
import sys
from collections import Counter
from pathlib import Path

import pytest
import torch

import tb2rl
from tb2rl.core import agent_names
from tb2rl.runs import read_lines

FOLDER = Path(__file__).parent.parent / "docs" / "benchmark"


@pytest.fixture
def module(monkeypatch):
    """A function that imports a module of the benchmark's folder."""
    monkeypatch.syspath_prepend(str(FOLDER))
    before = set(sys.modules)
    yield importlib.import_module
    for name in sys.modules.keys() - before & {file.stem for file in FOLDER.glob("*.py")}:
        del sys.modules[name]


def test_the_page_shows_the_stored_runs(module, tmp_path):
    page = module("page").write_page(tmp_path, read_lines(FOLDER / "runs.jsonl"))
    assert page.read_text() == (FOLDER / "README.md").read_text()
    assert {file.name for file in tmp_path.glob("*.svg")} == {file.name for file in FOLDER.glob("*.svg")}


def test_every_valid_pair_has_all_its_runs(module):
    pairs, run = module("pairs"), module("run")
    rows = [row for row in read_lines(FOLDER / "runs.jsonl") if row["seed"] != pairs.PILOT]
    counts = Counter((row["name"], row["task"]) for row in rows)
    in_physics = Counter((row["name"], row["task"]) for row in rows if "bullet" in row["results"])
    for pair in pairs.find_pairs():
        name, _ = pair
        seeds = 1 if pairs.is_rule(name) else run.SEEDS if name in agent_names() else run.OTHER_SEEDS
        assert (counts[pair], in_physics[pair]) == (seeds, min(seeds, run.PHYSICS_SEEDS)), pair


@pytest.mark.bullet
@pytest.mark.slow
def test_the_command_runs_only_what_is_missing(module, tmp_path, capsys):
    line = ["--seconds", "0.1", "--seeds", "1", "--folder", str(tmp_path), "--only", "tutorial"]
    run = module("run")
    run.main(line)
    file = tmp_path / "runs.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert sorted((row["task"], row["seed"]) for row in rows) == [("maze", -1), ("maze", 0), ("wall", -1), ("wall", 0)]
    assert all(0 <= result["good"] <= run.EPISODES for row in rows for result in row.get("results", {}).values())
    assert all(len(row["curve"]) == run.CURVE_POINTS for row in rows if row["seed"] == 0)
    file.write_text("".join(json.dumps(row) + "\n" for row in rows[:-1]))
    capsys.readouterr()
    run.main(line)
    assert capsys.readouterr().out.startswith(f"1 of 1: {rows[-1]['name']} at {rows[-1]['task']}")
    again = [json.loads(line) for line in file.read_text().splitlines()]
    assert again == rows  # a training can be repeated exactly


@pytest.mark.parametrize(("name", "task"), [("dqn", "maze"), ("ppo", "wall"), ("ppo", "drive")])
def test_other_programs_train_and_drive(module, name, task):
    train = getattr(module("peers"), f"train_{name}")
    seen = []
    trained = train(task, 0, 100, lambda timesteps: seen.append(timesteps) or True)
    assert trained.timesteps >= 100
    assert seen[0] == 0
    evaluation = tb2rl.evaluate(trained.policy, task=task, observation="raw", simulation="kinematic", episodes=2)
    assert len(evaluation.episodes) == 2
    again = train(task, 0, 100, lambda _: True).policy.state_dict()
    assert all(torch.equal(value, again[key]) for key, value in trained.policy.state_dict().items())
    assert train(task, 0, 100, lambda _: False).timesteps == 0


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
@pytest.mark.parametrize("program", ["tb2rl", "Stable-Baselines3", "CleanRL-style"])
@pytest.mark.slow
def test_every_program_has_a_rate(module, program, algorithm, capsys, monkeypatch):
    rates = module("rates")
    monkeypatch.setitem(rates.STEPS, algorithm, 64)
    monkeypatch.setattr(rates, "PPO", rates.PPO._replace(num_envs=4, num_steps=8, batch_size=16))
    monkeypatch.setattr(rates, "SAC", rates.SAC._replace(num_envs=4, learning_starts=16, batch_size=8))
    rates.main(["--one", program, algorithm])
    assert float(capsys.readouterr().out.splitlines()[-1]) > 0


def test_the_page_of_rates_has_a_row_for_each_program(module, tmp_path):
    rates = module("rates")
    measured = {
        (program, algorithm): [1.0, 30.0, 2345.6] for program in ("tb2rl", "CleanRL-style") for algorithm in rates.STEPS
    }
    text = rates.write_page(tmp_path, measured).read_text()
    assert text.count("| 30 (1 to 2,350) | 30 (1 to 2,350) |") == len(measured) / 2


def test_the_page_of_rates_is_of_this_program(module):
    rates = module("rates")
    page = (rates.FOLDER / "rates.md").read_text()
    assert page.startswith(rates.INTRODUCTION)
    assert all(f"| {program} |" in page for program in rates.PROGRAMS)


@pytest.mark.slow
def test_the_page_of_people_has_every_driver_in_every_crowd(module, tmp_path, monkeypatch):
    people = module("people")
    monkeypatch.setattr(people, "POLICIES", ())
    monkeypatch.setattr(people, "RULES", ("pursuit",))
    people.main(["--episodes", "2", "--simulation", "kinematic", "--folder", str(tmp_path)])
    rows = [line for line in (tmp_path / "people.md").read_text().splitlines() if re.match(r"\| (zoo|pursuit)", line)]
    assert [len(re.findall(r"\| [\d.]+ \([\d.]+, [\d.]+\) ", row)) for row in rows] == [len(people.CROWDS)] * 4


def test_the_page_of_people_is_of_this_program(module):
    people = module("people")
    page = (people.FOLDER / "people.md").read_text()
    assert page.startswith(people.INTRODUCTION)
    assert all(f"| {name}" in page for name in (*people.POLICIES, people.WITHOUT_PEOPLE, *people.RULES))
