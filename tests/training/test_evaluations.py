"""Evaluations during a training: their simulator, and how good ones stop a training early."""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

import pytest

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluate import Evaluator
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs.config import resolve
from tb2rl.simulation.simulator import default_physics
from tb2rl.train import main
from tb2rl.training.training import make_evaluator, resume, train_config

OFTEN = {"total_timesteps": 512, "eval_freq": 64, "eval_episodes": 20, "eval_steps": 10, "stop_score": None}


@pytest.fixture
def rates(monkeypatch):
    """Makes evaluations report the given shares of good episodes, and returns, one after the other."""
    run = Evaluator.run

    def report(*shares: float, returns: Sequence[float] = ()) -> None:
        left = list(zip_longest(shares, returns))

        def evaluate(evaluator: Evaluator, *arguments) -> Evaluation:
            evaluation, (share, found) = run(evaluator, *arguments), left.pop(0)
            good = round(share * len(evaluation.episodes))
            others = {} if found is None else {"episode_return": found}
            episodes = [
                replace(e, failed=i >= good, success=i < good, **others) for i, e in enumerate(evaluation.episodes)
            ]
            return replace(evaluation, episodes=episodes)

        monkeypatch.setattr(Evaluator, "run", evaluate)

    return report


def timesteps(evaluations) -> list[int]:
    return [each["timesteps"] for each in evaluations]


def test_good_evaluations_in_a_row_stop_a_training(small, rates, evaluations, tmp_path):
    rates(0.95, 0.9, 0.95, 0.95)
    settings = {"agent.n_steps": 32, "agent.batch_size": 64}
    trained = train_config(small("ppo", "maze", settings, **{**OFTEN, "stop_score": 0.95}), tmp_path / "run")
    assert trained.early_stop_timesteps == trained.timesteps == 256
    assert timesteps(evaluations(trained.run)) == [64, 128, 192, 256], "the last one is not repeated"
    assert load(trained.run.folder / "final" / "policy.safetensors").num_timesteps == 256


@pytest.mark.parametrize(
    ("train", "shares", "stopped_after"),
    [
        ({}, [1.0] * 8, None),
        ({"stop_score": 0.9}, [1.0, 0.5] * 4, None),
        ({"stop_score": 1.0, "stop_evaluations": 3}, [1.0] * 3, 192),
    ],
)
def test_when_evaluations_stop_a_training_is_a_setting(train, shares, stopped_after, small, rates, tmp_path):
    rates(*shares)
    trained = train_config(small(**{**OFTEN, **train}), tmp_path / "run")
    assert (trained.early_stop_timesteps, trained.timesteps) == (stopped_after, stopped_after or 512)


def test_a_stopped_training_continues_if_more_steps_are_asked(small, rates, evaluations, tmp_path):
    rates(1.0, 1.0)
    run = train_config(small(**{**OFTEN, "stop_score": 0.99}), tmp_path / "run").run
    with pytest.raises(
        InputError,
        match=r"stopped after 128 of 512 steps: 2 evaluations in a row reached the train.stop_score of 99 %; raise",
    ):
        resume(run.folder)
    rates(1.0, 0.9, 0.9, 1.0, 1.0)
    more = resume(run.folder, total_timesteps=1024)
    assert (more.early_stop_timesteps, more.timesteps) == (448, 320), "it counts anew"
    assert timesteps(evaluations(run)) == [64, 128, 192, 256, 320, 384, 448]


def test_a_resumed_training_stops_where_the_uninterrupted_one_did(small, rates, killed, assert_same_runs, tmp_path):
    rates(0.5, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0)
    config = small(**{**OFTEN, "stop_score": 0.99, "stop_evaluations": 3, "save_freq": 150, "keep": 9})
    whole = train_config(config, tmp_path / "whole")
    resumed = killed(whole.run, tmp_path / "resumed")
    rates(1.0, 0.5, 1.0, 1.0, 1.0)
    assert resume(resumed.folder).early_stop_timesteps == whole.early_stop_timesteps == 448
    assert_same_runs(whole.run, resumed)


def test_the_command_prints_that_a_training_was_stopped_and_notes_its_evaluations(rates, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rates(1.0, 1.0)
    flags = "--simulation kinematic --n-envs 4 --total-timesteps 512 --eval-freq 64 --no-evaluation --name run"
    few, simulation = ["train.stop_score=0.995", "train.eval_episodes=3", "train.eval_steps=10"], default_physics().name
    main([*flags.split(), "--set", *few, f"train.eval_simulation={simulation}"])
    assert (
        "stopped after 128 of 512 steps: 2 evaluations in a row reached the train.stop_score of 99.5 %\n"
        in capsys.readouterr().out
    )
    line, _ = map(json.loads, (tmp_path / "runs/maze/qlearn/run/evaluations.jsonl").read_text().splitlines())
    assert (line["simulation"], line["episodes"], line["steps"]) == (simulation, 3, 10)
    assert line["median_squares"] >= 1
    assert 0.0 < line["seconds"] <= line["elapsed"]


@pytest.mark.parametrize(
    ("settings", "simulation", "episodes"),
    [
        ({}, "kinematic", 1000),
        ({"train.eval_simulation": "bullet"}, "bullet", 20),
        ({"task.observe": ["camera"]}, "kinematic", 20),
        ({"task.observe": [{"camera": {"colour": True}}]}, "bullet", 20),
    ],
)
def test_an_evaluation_has_fewer_episodes_if_a_step_takes_time(settings, simulation, episodes, capsys):
    config = resolve("stable_baselines3:PPO", settings=settings)
    with make_evaluator(config.scene, config.train) as evaluator:
        assert (evaluator.simulator.name, len(evaluator.initial_states.table)) == (simulation, episodes)
    refused = "use PyBullet, and are slower: the cameras of simulation 'kinematic' see depth but"
    assert (refused in capsys.readouterr().out) == (simulation != config.train.eval_simulation)


def test_evaluations_are_in_validation_worlds(small):
    world = {"task.world": {"generator": "rooms", "worlds": 4, "difficulty": 0.0}}
    config = small(settings=world, eval_episodes=2)
    with make_evaluator(config.scene.for_purpose("validation"), config.train) as evaluator:
        worlds = [world.name for world in evaluator.scene.spec.worlds]
    assert worlds == [f"rooms {i} (validation)" for i in range(4)]


@pytest.mark.parametrize(("best_by", "timesteps"), [("success", 128), ("return", 192)])
def test_best_by_decides_which_policy_is_kept(best_by, timesteps, small, rates, tmp_path):
    rates(0.5, 0.9, 0.8, 0.8, returns=(7.0, 1.0, 9.0, 8.0))  # a robot that turns on the spot collides least
    trained = train_config(small(**{**OFTEN, "total_timesteps": 256, "best_by": best_by}), tmp_path / "run")
    assert load(trained.run.folder).num_timesteps == timesteps
