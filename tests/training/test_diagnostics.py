"""A training that does not learn prints advice once; one that learns prints nothing."""

import numpy as np
import pytest

from tb2rl.training.statistics import ADVICE
from tb2rl.training.training import resume, train_config

PROBLEMS = {
    "failing": {"task.collision_range": 1.5, "agent.exploration_fraction": 0.1},
    "spinning": {
        "task.forward_reward": 0.0,
        "task.turn_reward": 5.0,
        "train.episode_steps": 100,
        "agent.exploration_fraction": 0.5,
        "agent.exploration_final_eps": 0.02,
    },
    "flat": {"agent.learning_rate": 0.0, "agent.exploration_fraction": 0.01},
    "values": {"agent.learning_rate": 3.0},
}


@pytest.mark.parametrize("problem", PROBLEMS)
def test_a_problem_is_named_once_with_advice(problem, small, scalars, tmp_path, capsys):
    run = train_config(small(settings=PROBLEMS[problem], n_envs=64, total_timesteps=40_000), tmp_path / "run").run
    warnings = capsys.readouterr().err.splitlines()
    assert len([line for line in warnings if ADVICE[problem] in line]) == 1
    assert all(line.startswith("warning: after ") for line in warnings)
    assert max(value for _, value in scalars(run, f"diagnostics/{problem}")) == 1.0
    resume(run.folder, 41_000)
    assert ADVICE[problem] not in capsys.readouterr().err, "once is enough, resumed or not"


def test_a_score_by_spinning_warns_and_does_not_stop_the_training(small, scalars, tmp_path, capsys):
    """With its random actions the exploring robot moves too much to be said to spin."""
    settings = {"task.forward_reward": 0.0, "task.turn_reward": 5.0, "train.stop_score": 0.5, "train.eval_steps": 200}
    evaluations = {"eval_freq": 5_000, "eval_episodes": 10, "total_timesteps": 40_000, "n_envs": 64}
    training = train_config(small(settings=settings, **evaluations), tmp_path / "run")
    assert training.early_stop_timesteps is None
    assert scalars(training.run, "eval/spins")[-1][1] == 1.0
    assert scalars(training.run, "eval/score")[-1][1] > 0.5
    assert capsys.readouterr().err.count(ADVICE["spinning"]) == 1


LARGE_STEPS = {
    "dqn": {"agent.learning_rate": 10.0, "agent.learning_starts": 100, "agent.batch_size": 32},
    "sb3_contrib:RecurrentPPO": {
        "agent.learning_rate": 1000.0,
        "agent.gamma": 0.5,
        "agent.n_steps": 16,
        "agent.policy_kwargs.lstm_hidden_size": 8,
    },
}


@pytest.mark.parametrize(("agent", "steps"), [("dqn", 1500), ("sb3_contrib:RecurrentPPO", 256)])
def test_diverging_values_of_a_network_are_named(agent, steps, small, tmp_path, capsys):
    train_config(small(agent, settings=LARGE_STEPS[agent], n_envs=8, total_timesteps=steps), tmp_path / "run")
    assert ADVICE["values"] in capsys.readouterr().err


@pytest.mark.parametrize("agent", ["qlearn", pytest.param("ppo", marks=pytest.mark.slow)])
def test_a_training_that_learns_prints_nothing(agent, small, tmp_path, capsys):
    config = small(agent, settings={"train.episode_steps": 300}, n_envs=64, total_timesteps=150_000)
    training = train_config(config, tmp_path / "run")
    assert np.mean(training.episode_lengths[-50:]) > 150
    assert capsys.readouterr().err == ""


def test_a_slow_robot_is_not_said_to_turn_on_the_spot(small, tmp_path, capsys):
    speeds = {"task.forward_speed": 0.07, "task.turn_speed": 0.07, "task.turn_rate": 0.1, "train.episode_steps": 100}
    train_config(small(settings=speeds, n_envs=64, total_timesteps=20_000), tmp_path / "run")
    assert ADVICE["spinning"] not in capsys.readouterr().err
