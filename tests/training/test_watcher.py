"""A training that does not learn says so, in one line with what to try; one that learns says nothing."""

from __future__ import annotations

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.training.training import resume, train_config
from tb2rl.training.watcher import ADVICE, Watcher

TROUBLES = {
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


@pytest.mark.parametrize("problem", TROUBLES)
def test_a_problem_is_named_once_with_what_to_try(problem, small, scalars, tmp_path, capsys):
    config = small(settings=TROUBLES[problem], n_envs=64, total_timesteps=40_000)
    run = train_config(config, tmp_path / "run").run
    warnings = capsys.readouterr().err.splitlines()
    assert len([line for line in warnings if ADVICE[problem] in line]) == 1
    assert all(line.startswith("warning: after ") for line in warnings)
    assert max(value for _, value in scalars(run, f"watch/{problem}")) == 1.0
    if problem == "values":
        with pytest.raises(InputError, match="weights that learning does not lead to"):
            resume(run.folder, 41_000)
        return
    resume(run.folder, 41_000)
    assert ADVICE[problem] not in capsys.readouterr().err, "once is enough, resumed or not"


def test_a_network_whose_values_run_away_is_named(small, tmp_path, capsys):
    settings = {"agent.learning_rate": 10.0, "agent.learning_starts": 100, "agent.batch_size": 32}
    train_config(small("dqn", settings=settings, n_envs=8, total_timesteps=1500), tmp_path / "run")
    assert ADVICE["values"] in capsys.readouterr().err


def test_the_values_of_a_network_with_a_memory_are_watched_too(small, tmp_path, capsys):
    settings = {
        "agent.learning_rate": 1000.0,
        "agent.gamma": 0.5,
        "agent.n_steps": 16,
        "agent.policy_kwargs.lstm_hidden_size": 8,
    }
    config = small("sb3_contrib:RecurrentPPO", settings=settings, n_envs=8, total_timesteps=256)
    train_config(config, tmp_path / "run")
    assert ADVICE["values"] in capsys.readouterr().err


@pytest.mark.parametrize("agent", ["qlearn", "ppo"])
def test_a_training_that_learns_is_left_alone(agent, small, tmp_path, capsys):
    training = train_config(
        small(agent, settings={"train.episode_steps": 300}, n_envs=64, total_timesteps=150_000), tmp_path / "run"
    )
    assert np.mean(training.lengths[-50:]) > 150
    assert capsys.readouterr().err == ""


def test_a_robot_that_cannot_drive_fast_is_not_said_to_turn_on_the_spot(small, tmp_path, capsys):
    speeds = {"task.forward_speed": 0.07, "task.turn_speed": 0.07, "task.turn_rate": 0.1, "train.episode_steps": 100}
    train_config(small(settings=speeds, n_envs=64, total_timesteps=20_000), tmp_path / "run")
    assert ADVICE["spinning"] not in capsys.readouterr().err


def test_a_return_is_not_flat_after_a_single_look():
    watcher = Watcher(total_timesteps=900, control_period=0.2, max_speed=0.5)
    watcher.restore(
        {
            "_next": 0,
            "_latest": [(1.0, 10, 1.0, True), (3.0, 10, 1.0, True)],
            "_history": [(100, 2.0), (900, 2.0)],
            "_largest_reward": 5.0,
            "warned": [],
        }
    )
    watcher.num_timesteps = 900
    assert not watcher._return_is_flat(), "of the last third there is one look only"
    watcher._history.insert(1, (700, 2.0))
    assert watcher._return_is_flat()


def test_it_goes_on_with_what_it_has_seen():
    watcher, other = (Watcher(total_timesteps=900, control_period=0.2, max_speed=0.5) for _ in range(2))
    seen = {"_next": 7, "_latest": [[1.0, 10, 1.5, True]], "_history": [[100, 2.0]], "_largest_reward": 5.0}
    watcher.restore({**seen, "warned": ["flat"]})
    other.restore(watcher.state())
    assert other.state() == watcher.state()
    assert list(other.state()["_latest"]) == [(1.0, 10, 1.5, True)]
