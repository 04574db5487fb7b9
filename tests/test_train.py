"""The command `train`: its output, its files, seeds, resuming."""

import json
import re
from contextlib import nullcontext
from functools import partial
from importlib import import_module
from types import SimpleNamespace

import pytest

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.training.statistics import tutorial_scores

work = import_module("tb2rl.commands.train")
command = import_module("tb2rl.train")  # `from tb2rl import train` is the function
BARE = ["--n-envs", "1", "--eval-freq", "0", "--simulation", "kinematic"]


@pytest.fixture
def folder(workdir):
    """The run folder of a training named "it"."""
    return workdir / "runs" / "maze" / "qlearn" / "it"


def test_it_leaves_the_standard_evaluation_in_the_run_folder(folder, monkeypatch, capsys):
    short = partial(work.evaluate, episodes=3, steps=20, workers=1)
    monkeypatch.setattr(work, "evaluate", short)
    command.main(["--name", "it", "--total-timesteps", "16", *BARE])
    written = json.loads((folder / "evaluation.json").read_text())
    assert (written["episodes"], written["steps"], len(written["each"])) == (3, 20, 3)
    out = capsys.readouterr().out
    shown = ["runs/maze/qlearn/it", "training qlearn at maze in loop: 16 steps in "]
    shown += ["trained 16 steps", f"{100 * written['failure_free_rate']:.1f} %"]
    assert [text for text in shown if text not in out] == []
    assert (folder / "episodes.safetensors").is_file()


def test_verbose_prints_the_tutorials_lines_and_scores(folder, capsys):
    command.main(["--preset", "tutorial", "--episodes", "3", "--name", "it", "-v", "--no-evaluation", *BARE])
    out = capsys.readouterr().out
    line = r"EP: (\d+) - \[alpha: 0.1 - gamma: 0.7 - epsilon: ([\d.]+)\] - Reward: (-?\d+) - Steps: (\d+) - Time: 0:00:"
    lines = re.findall(rf"^{line}\d\d$", out, re.MULTILINE)
    assert [int(number) for number, *_ in lines] == [1, 2, 3]
    assert [float(epsilon) for _, epsilon, *_ in lines] == pytest.approx([0.9 * 0.999**n for n in (1, 2, 3)], abs=1e-4)
    lengths = [int(steps) for *_, steps in lines]
    assert [int(total) for _, _, total, _ in lines] == [pytest.approx(-200, abs=5 * steps) for steps in lengths]
    assert out.splitlines()[-1] == tutorial_scores(lengths)
    assert not (folder / "evaluation.json").exists()


def test_a_run_without_a_name_is_called_by_its_options(workdir):
    options = "--preset tutorial --total-timesteps 16 --set agent.learning_rate=0.5 agent.gamma=0.5 --no-evaluation"
    command.main([*options.split(), *BARE])
    (folder,) = (workdir / "runs/maze/qlearn").iterdir()
    assert folder.name.startswith("seed=0-preset=tutorial-learning_rate=0.5-gamma=0.5-")


def test_a_run_is_resumed_with_nothing_but_more_steps(folder, capsys, refused):
    command.main(["--name", "it", "--total-timesteps", "64", "--no-evaluation", *BARE])
    command.main(["--resume", str(folder), "--total-timesteps", "128", "--no-evaluation"])
    assert f"resuming {folder}" in capsys.readouterr().out
    assert load(folder).num_timesteps == 128
    for more in ("--agent dqn", "--set agent.gamma=0.5", "--seed 0"):
        refused(command.main, f"--resume {folder} {more}", [more.split()[0], "can only raise --total-timesteps"])


class InThisProcess(nullcontext):
    """An executor whose jobs run in this process."""

    remote = False

    def as_completed(self, function, jobs, shared):
        return ((job, function(*shared, *job.arguments, job.folder)) for job in jobs)


def test_several_seeds_are_trained_evaluated_and_summed_up(folder, monkeypatch, capsys):
    rates = iter([1.0, 0.5, 0.96])
    evaluation = SimpleNamespace(task=SimpleNamespace(world="loop"), serialize=lambda *_: ({}, {}))
    monkeypatch.setattr(work, "evaluate", lambda *_, **__: evaluation)
    summary = {"mean_distance": 10.0}
    monkeypatch.setattr(work, "print_evaluation", lambda *_: {**summary, "success_rate": next(rates)})
    monkeypatch.setattr(work, "make_executor", lambda options: InThisProcess())
    command.main(["--seeds", "3..5", "--name", "it", "--total-timesteps", "8", *BARE])
    assert [load(folder / f"seed-{seed}").seed for seed in (3, 4, 5)] == [3, 4, 5]
    assert "trained 8 steps" in (folder / "seed-3" / "log.txt").read_text()
    figures = json.loads((folder / "seeds.json").read_text())
    assert (figures["seeds"], figures["failed"]) == ([3, 4, 5], [4])
    assert figures["success"]["mean"] == pytest.approx(0.82)
    low, high = figures["success"]["interval"]
    assert 0.5 <= low < 0.82 < high <= 1.0
    assert "failed (success below 95 %): 1 of 3: 4" in capsys.readouterr().out


def test_seeds_are_parsed():
    assert [work.parse_seeds(text) for text in ("0..4", "7", "3,1")] == [[0, 1, 2, 3, 4], [7], [3, 1]]
    for text in ("", "4..2", "1,1", "-1", "0..", "0..99999"):
        with pytest.raises(InputError, match=r"0\.\.4"):
            work.parse_seeds(text)


def test_a_policy_trained_with_the_safety_filter_keeps_it(workdir):
    settings = ["--set", "task.filters=[{speed_limits: {speed: 0.4}}]", "agent.n_steps=8", "agent.batch_size=8"]
    trained = ["--agent", "ppo", "--task", "drive", "--name", "it", "--total-timesteps", "8", "--no-evaluation"]
    command.main([*trained, *BARE, *settings, "--safe"])
    names = [type(each).__name__ for each in load(workdir / "runs/drive/ppo/it").trained_with.scene.filters]
    assert names == ["Safety", "SpeedLimits"]
