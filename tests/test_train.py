"""The command `train`: what it prints, what it leaves, seeds, resuming."""

from __future__ import annotations

import json
import re
from importlib import import_module
from types import SimpleNamespace

import pytest

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.training.statistics import tutorial_scores

work, seeds_work = import_module("tb2rl.commands.train"), import_module("tb2rl.commands.seeds")
command = import_module("tb2rl.train")  # `from tb2rl import train` is the function
BARE = ["--n-envs", "1", "--eval-freq", "0"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The run folder of a training that is called "it", in a working directory of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path / "runs" / "maze" / "qlearn" / "it"


def test_it_leaves_the_standard_evaluation_in_the_run_folder(folder, capsys):
    command.main(["--name", "it", "--total-timesteps", "16", *BARE])
    written = json.loads((folder / "evaluation.json").read_text())
    assert (written["episodes"], written["steps"], len(written["each"])) == (100, 1500, 100)
    out = capsys.readouterr().out
    assert "runs/maze/qlearn/it" in out
    assert "training qlearn at maze in loop: 16 steps, 1 environment, seed 0" in out
    assert "trained 16 steps" in out
    assert f"{100 * written['failure_free_rate']:.1f} %" in out
    assert (folder / "episodes.safetensors").is_file()


def test_verbose_prints_the_tutorials_lines_and_scores(capsys):
    command.main(["--preset", "tutorial", "--episodes", "3", "--name", "it", "-v", "--no-evaluation", *BARE])
    out = capsys.readouterr().out
    lines = re.findall(
        r"^EP: (\d+) - \[alpha: 0.1 - gamma: 0.7 - epsilon: ([\d.]+)\] - Reward: (-?\d+) - Steps: (\d+) - "
        r"Time: 0:00:\d\d$",
        out,
        re.MULTILINE,
    )
    assert [(int(number), float(epsilon)) for number, epsilon, _, _ in lines] == [
        (number, pytest.approx(0.9 * 0.999**number, abs=1e-4)) for number in (1, 2, 3)
    ]
    lengths = [int(steps) for *_, steps in lines]
    assert [int(total) for _, _, total, _ in lines] == [pytest.approx(-200, abs=5 * steps) for steps in lengths]
    assert out.splitlines()[-1] == tutorial_scores(lengths)


def test_without_the_evaluation_there_is_none(folder):
    command.main(["--name", "it", "--total-timesteps", "8", "--no-evaluation", *BARE])
    assert load(folder).num_timesteps == 8
    assert not (folder / "evaluation.json").exists()


@pytest.mark.parametrize(
    "wrong",
    [
        ["--agent", "random"],
        ["--name", "taken"],
        ["--name", "\udcff"],
        ["--agent", "ppo", "--set", "agent.batch_size=1"],
    ],
)
def test_only_a_training_that_begins_names_its_run_folder(wrong, folder, capsys):
    folder.with_name("taken").mkdir(parents=True)
    (folder.with_name("taken") / "config.yaml").touch()
    with pytest.raises(SystemExit):
        command.main([*BARE, "--no-evaluation", *wrong])
    seen = capsys.readouterr()
    assert seen.out == ""
    assert seen.err.count("\n") == 1


def test_only_a_training_that_goes_on_says_that_it_is_resumed(folder, capsys):
    with pytest.raises(SystemExit):
        command.main(["--resume", str(folder)])
    assert capsys.readouterr().out == ""


def test_a_run_is_resumed_with_nothing_but_more_steps(folder, capsys):
    short = ["--total-timesteps", "64", "--simulation", "kinematic", "--no-evaluation"]
    command.main(["--name", "it", *short, *BARE])
    command.main(["--resume", str(folder), "--total-timesteps", "128", "--no-evaluation"])
    assert f"resuming {folder}" in capsys.readouterr().out
    assert load(folder).num_timesteps == 128
    for more in (["--agent", "dqn"], ["--set", "agent.gamma=0.5"], ["--seed", "1"], ["--name", "it"]):
        with pytest.raises(SystemExit):
            command.main(["--resume", str(folder), *more])
        assert "only --total-timesteps can be raised" in capsys.readouterr().err


def test_several_seeds_are_trained_evaluated_and_summed_up(folder, monkeypatch, capsys):
    rates = iter([1.0, 0.5, 0.96])
    evaluation = SimpleNamespace(task=SimpleNamespace(world="loop"), tree=lambda *_: ({}, {}))
    monkeypatch.setattr(seeds_work, "evaluate", lambda *_, **__: evaluation)
    summary = {"mean_distance": 10.0}
    monkeypatch.setattr(seeds_work, "print_evaluation", lambda *_: {**summary, "success_rate": next(rates)})

    def here(jobs, _, shared):
        return [(job, job.function(shared, job.folder, *job.arguments)) for job in jobs]

    monkeypatch.setattr(seeds_work, "run_jobs", here)
    command.main(["--seeds", "3..5", "--name", "it", "--total-timesteps", "8", *BARE])
    assert [load(folder / f"seed-{seed}").seed for seed in (3, 4, 5)] == [3, 4, 5]
    assert "trained 8 steps" in (folder / "seed-3" / "log.txt").read_text()
    figures = json.loads((folder / "seeds.json").read_text())
    assert (figures["seeds"], figures["failed"]) == ([3, 4, 5], [4])
    assert figures["success"]["mean"] == pytest.approx(0.82)
    low, high = figures["success"]["interval"]
    assert 0.5 <= low < 0.82 < high <= 1.0
    assert "failed (success below 95 %): 1 of 3: 4" in capsys.readouterr().out


def test_processes_are_for_several_seeds(folder, capsys):
    for more in (["--on", "ray"], ["--workers", "2"]):
        with pytest.raises(SystemExit):
            command.main(["--name", "it", *more])
        assert "--on and --workers go with --seeds" in capsys.readouterr().err


@pytest.mark.parametrize(("text", "seeds"), [("0..4", [0, 1, 2, 3, 4]), ("7", [7]), ("3,1", [3, 1]), ("2..2", [2])])
def test_seeds_are_read_from_the_command_line(text, seeds):
    assert work.parse_seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "4..2", "1,1", "-1", "a", "0..", "0..99999", "1.5"])
def test_what_does_not_name_seeds_is_refused(text):
    with pytest.raises(InputError, match=r"0\.\.4"):
        work.parse_seeds(text)


@pytest.mark.parametrize("more", [["--seed", "1"], ["--no-evaluation"]])
def test_several_seeds_go_with_neither_one_seed_nor_no_evaluation(more, folder, capsys):
    with pytest.raises(SystemExit):
        command.main(["--seeds", "0..1", "--name", "it", *more])
    assert "--seeds goes neither with" in capsys.readouterr().err
    assert not folder.exists()
