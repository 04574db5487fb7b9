"""Evaluations while training: where they drive, and how good ones stop a training before its time is up."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

import pytest

from tb2rl import load
from tb2rl.commands.train import run as train_command
from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.twin import TwinEvaluator
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.layers import resolve
from tb2rl.train import parse
from tb2rl.training import training
from tb2rl.training.training import resume, train_config

OFTEN = {
    "n_envs": 4,
    "total_timesteps": 512,
    "eval_freq": 64,
    "eval_episodes": 20,
    "eval_steps": 10,
    "stop_score": None,
}


@pytest.fixture
def rates(monkeypatch):
    """A function that makes the evaluations find these shares of good episodes, and returns, one after the other."""
    run = TwinEvaluator.run

    def find(*shares: float, returns: Sequence[float] = ()) -> None:
        left = list(zip_longest(shares, returns))

        def evaluate(evaluator: TwinEvaluator, *arguments) -> Evaluation:
            evaluation, (share, found) = run(evaluator, *arguments), left.pop(0)
            good = round(share * len(evaluation.episodes))
            others = {} if found is None else {"episode_return": found}
            episodes = [
                replace(e, failed=i >= good, success=i < good, **others) for i, e in enumerate(evaluation.episodes)
            ]
            return replace(evaluation, episodes=episodes)

        monkeypatch.setattr(TwinEvaluator, "run", evaluate)

    return find


def evaluated(run) -> list[int]:
    return [json.loads(line)["timesteps"] for line in (run.folder / "evaluations.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("agent", ["qlearn", "ppo", "dqn"])
def test_good_evaluations_in_a_row_stop_a_training(agent, small, rates, tmp_path):
    rates(0.95, 0.9, 0.95, 0.95)
    settings = {"ppo": {"agent.n_steps": 32, "agent.batch_size": 64}}.get(agent)
    trained = train_config(small(agent, settings=settings, **{**OFTEN, "stop_score": 0.95}), tmp_path / "run")
    assert trained.stopped_after == trained.timesteps == 256
    assert evaluated(trained.run) == [64, 128, 192, 256], "and the last one is not driven twice"
    assert load(trained.run.folder / "final" / "policy.safetensors").num_timesteps == 256


def test_without_a_score_or_without_enough_good_evaluations_it_goes_on(small, rates, tmp_path):
    rates(*[1.0] * 8)
    assert train_config(small(**OFTEN), tmp_path / "one").stopped_after is None
    rates(*[1.0, 0.5] * 4)
    trained = train_config(small(**{**OFTEN, "stop_score": 0.9}), tmp_path / "other")
    assert (trained.stopped_after, trained.timesteps) == (None, 512)
    assert evaluated(trained.run)[-1] == 512


def test_how_many_evaluations_in_a_row_is_a_setting(small, rates, tmp_path):
    rates(1.0, 1.0, 1.0)
    assert (
        train_config(small(**{**OFTEN, "stop_score": 1.0, "stop_evaluations": 3}), tmp_path / "run").stopped_after
        == 192
    )


def test_a_goal_task_counts_the_goals(small, rates, tmp_path):
    rates(1.0, 1.0)
    assert train_config(small(task="wall", **{**OFTEN, "stop_score": 1.0}), tmp_path / "run").stopped_after == 128


def test_a_stopped_training_has_ended_until_more_steps_are_asked(small, rates, tmp_path):
    rates(1.0, 1.0)
    run = train_config(small(**{**OFTEN, "stop_score": 0.99}), tmp_path / "run").run
    with pytest.raises(InputError, match=r"stopped after 128 of 512 steps: 2 evaluations in a row reached 99 %; raise"):
        resume(run.folder)
    rates(1.0, 0.9, 0.9, 1.0, 1.0)
    more = resume(run.folder, total_timesteps=1024)
    assert (more.stopped_after, more.timesteps) == (448, 320), "and counts anew"
    assert evaluated(run) == [64, 128, 192, 256, 320, 384, 448]


def test_a_resumed_training_stops_where_the_uninterrupted_one_did(small, rates, killed, differences, tmp_path):
    rates(0.5, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0)
    config = small(**{**OFTEN, "stop_score": 0.99, "stop_evaluations": 3, "save_freq": 150, "keep": 9})
    whole = train_config(config, tmp_path / "whole")
    assert whole.stopped_after == 448
    resumed = killed(whole.run, tmp_path / "resumed")
    rates(1.0, 0.5, 1.0, 1.0, 1.0)
    assert resume(resumed.folder).stopped_after == 448
    assert evaluated(whole.run) == evaluated(resumed)
    assert differences(*(read_checkpoint(run.checkpoints[0]) for run in (whole.run, resumed))) == []


def test_the_output_says_that_a_training_was_stopped(rates, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rates(1.0, 1.0)
    flags = "--simulation kinematic --n-envs 4 --total-timesteps 512 --eval-freq 64 --no-evaluation --name run"
    train_command(parse([*flags.split(), "--set", "train.stop_score=0.995", "train.eval_episodes=20"]))
    assert "stopped after 128 of 512 steps: 2 evaluations in a row reached 99.5 %\n" in capsys.readouterr().out


# ---- where evaluations drive


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_evaluations_drive_where_they_are_told_to(simulation, small, tmp_path):
    few = {"eval_freq": 128, "eval_episodes": 3, "eval_steps": 10, "eval_simulation": simulation}
    run = train_config(small(**few), tmp_path / "run").run
    (line,) = map(json.loads, (run.folder / "evaluations.jsonl").read_text().splitlines())
    assert (line["simulation"], line["episodes"], line["steps"]) == (simulation, 3, 10)
    assert line["median_squares"] >= 1


@pytest.mark.parametrize(
    ("settings", "episodes"), [({}, 1000), ({"eval_simulation": "bullet"}, 20), ({"observe": ["camera"]}, 20)]
)
def test_evaluations_are_fewer_where_a_step_takes_time(settings, episodes):
    dotted = {f"task.{key}" if key == "observe" else f"train.{key}": value for key, value in settings.items()}
    config = resolve("stable_baselines3:PPO", settings=dotted | {"train.eval_steps": 2})
    with training.make_evaluator(config) as evaluator:
        algorithm = make_algorithm(config, Spaces.vectorised(config))
        assert len(evaluator.run(algorithm.policy).episodes) == episodes


def test_what_the_twin_cannot_observe_is_evaluated_in_pybullet(small, tmp_path, monkeypatch, capsys):
    def refuse(*_arguments) -> None:
        raise InputError("the twin has no colours")

    monkeypatch.setattr(training, "TwinEvaluator", refuse)
    run = train_config(small(eval_freq=128, eval_episodes=3, eval_steps=10), tmp_path / "run").run
    assert "evaluations on the way are in PyBullet, and slower: the twin has no colours\n" in capsys.readouterr().out
    (line,) = map(json.loads, (run.folder / "evaluations.jsonl").read_text().splitlines())
    assert line["simulation"] == "bullet"


@pytest.mark.parametrize(("best_by", "kept"), [("success", 128), ("return", 192)])
def test_the_policy_is_kept_that_has_the_most_of_what_counts(best_by, kept, small, rates, tmp_path):
    rates(0.5, 0.9, 0.8, 0.8, returns=(7.0, 1.0, 9.0, 8.0))  # a robot that turns on the spot crashes least
    settings = {**OFTEN, "total_timesteps": 256, "best_by": best_by}
    trained = train_config(small("qlearn", **settings), tmp_path / "run")
    assert load(trained.run.folder).num_timesteps == kept
