"""The command `train`: its output, its files, seeds, resuming."""

from __future__ import annotations

import json
import re
from contextlib import nullcontext
from importlib import import_module
from types import SimpleNamespace

import pytest

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.training.statistics import tutorial_scores

train_command, seeds_command = import_module("tb2rl.commands.train"), import_module("tb2rl.commands.seeds")
command = import_module("tb2rl.train")  # `from tb2rl import train` is the function
BARE = ["--n-envs", "1", "--eval-freq", "0", "--simulation", "kinematic"]


@pytest.fixture
def folder(workdir):
    """The run folder of a training named "it"."""
    return workdir / "runs" / "maze" / "qlearn" / "it"


def test_it_leaves_the_standard_evaluation_in_the_run_folder(folder, monkeypatch, capsys):
    evaluate = train_command.evaluate
    short = {"episodes": 3, "steps": 20, "workers": 1}
    monkeypatch.setattr(train_command, "evaluate", lambda policy, **more: evaluate(policy, **short, **more))
    command.main(["--name", "it", "--total-timesteps", "16", *BARE])
    written = json.loads((folder / "evaluation.json").read_text())
    assert (written["episodes"], written["steps"], len(written["each"])) == (3, 20, 3)
    out = capsys.readouterr().out
    shown = ["runs/maze/qlearn/it", "training qlearn at maze in loop: 16 steps, 1 environment, seed 0"]
    shown += ["trained 16 steps", f"{100 * written['failure_free_rate']:.1f} %"]
    assert [text for text in shown if text not in out] == []
    assert (folder / "episodes.safetensors").is_file()


def test_verbose_prints_the_tutorials_lines_and_scores(folder, capsys):
    command.main(["--preset", "tutorial", "--episodes", "3", "--name", "it", "-v", "--no-evaluation", *BARE])
    out = capsys.readouterr().out
    line = r"EP: (\d+) - \[alpha: 0.1 - gamma: 0.7 - epsilon: ([\d.]+)\] - Reward: (-?\d+) - Steps: (\d+) - Time: 0:00:"
    lines = re.findall(rf"^{line}\d\d$", out, re.MULTILINE)
    assert [(int(number), float(epsilon)) for number, epsilon, _, _ in lines] == [
        (number, pytest.approx(0.9 * 0.999**number, abs=1e-4)) for number in (1, 2, 3)
    ]
    lengths = [int(steps) for *_, steps in lines]
    assert [int(total) for _, _, total, _ in lines] == [pytest.approx(-200, abs=5 * steps) for steps in lengths]
    assert out.splitlines()[-1] == tutorial_scores(lengths)
    assert not (folder / "evaluation.json").exists()


def test_a_run_is_resumed_with_nothing_but_more_steps(folder, capsys, refused):
    command.main(["--name", "it", "--total-timesteps", "64", "--no-evaluation", *BARE])
    command.main(["--resume", str(folder), "--total-timesteps", "128", "--no-evaluation"])
    assert f"resuming {folder}" in capsys.readouterr().out
    assert load(folder).num_timesteps == 128
    for more in (["--agent", "dqn"], ["--set", "agent.gamma=0.5"], ["--seed", "1"], ["--name", "it"]):
        refused(command.main, ["--resume", str(folder), *more], ["only --total-timesteps can be raised"])


class InThisProcess(nullcontext):
    """An executor whose jobs run in this process."""

    remote = False

    def as_completed(self, function, jobs, shared):
        return ((job, function(*shared, *job.arguments, job.folder)) for job in jobs)


def test_several_seeds_are_trained_evaluated_and_summed_up(folder, monkeypatch, capsys):
    rates = iter([1.0, 0.5, 0.96])
    evaluation = SimpleNamespace(task=SimpleNamespace(world="loop"), tree=lambda *_: ({}, {}))
    monkeypatch.setattr(seeds_command, "evaluate", lambda *_, **__: evaluation)
    summary = {"mean_distance": 10.0}
    monkeypatch.setattr(seeds_command, "print_evaluation", lambda *_: {**summary, "success_rate": next(rates)})
    monkeypatch.setattr(train_command, "make_executor", lambda options: InThisProcess())
    command.main(["--seeds", "3..5", "--name", "it", "--total-timesteps", "8", *BARE])
    assert [load(folder / f"seed-{seed}").seed for seed in (3, 4, 5)] == [3, 4, 5]
    assert "trained 8 steps" in (folder / "seed-3" / "log.txt").read_text()
    figures = json.loads((folder / "seeds.json").read_text())
    assert (figures["seeds"], figures["failed"]) == ([3, 4, 5], [4])
    assert figures["success"]["mean"] == pytest.approx(0.82)
    low, high = figures["success"]["interval"]
    assert 0.5 <= low < 0.82 < high <= 1.0
    assert "failed (success below 95 %): 1 of 3: 4" in capsys.readouterr().out


@pytest.mark.parametrize(("text", "seeds"), [("0..4", [0, 1, 2, 3, 4]), ("7", [7]), ("3,1", [3, 1]), ("2..2", [2])])
def test_seeds_are_parsed(text, seeds):
    assert train_command.parse_seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "4..2", "1,1", "-1", "a", "0..", "0..99999"])
def test_other_text_is_no_seeds(text):
    with pytest.raises(InputError, match=r"0\.\.4"):
        train_command.parse_seeds(text)
