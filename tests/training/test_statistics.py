"""Episode statistics in TensorBoard, and the lines of the ROS tutorial."""

import re

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl.training.statistics import tutorial_scores
from tb2rl.training.training import train_config

ENDINGS = {  # settings with which all episodes end alike, and the failure rate
    "collision": ("maze", {"task.collision_range": 3.0}, 1.0),
    "goal": ("wall", {"task.goal_tolerance": 90.0, "task.collision_range": 0.0}, 0.0),
    "time limit": ("maze", {"train.episode_steps": 2, "task.start_clearance": 0.8}, 0.0),
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_task_says_which_endings_count_as_failed(ending, small, scalars, tmp_path):
    task, settings, rate = ENDINGS[ending]
    run = train_config(small(task=task, settings=settings), tmp_path / "run").run
    assert {value for _, value in scalars(run, "rollout/failure_rate")} == {rate}


def test_the_distance_is_the_mean_of_the_latest_episodes(small, scalars, tmp_path):
    settings = {"train.episode_steps": 2, "task.start_clearance": 0.8, "agent.exploration_initial_eps": 0.0}
    settings |= {"task.turn_speed": 0.5, "task.turn_rate": 1.0e-9}  # whatever it does, it drives
    run = train_config(small(settings=settings, n_envs=2, total_timesteps=8), tmp_path / "run").run
    (_, distance), *_ = scalars(run, "rollout/distance_mean")
    assert 0.1 < distance < 0.2  # [m] two steps of 0.2 s at 0.5 m/s at most, from rest


@pytest.mark.parametrize(("agent", "setting", "value"), [("qlearn", "update", "textbook"), ("dqn", "tau", 1.0)])
def test_tensorboards_table_of_hyperparameters_has_columns_for_all_agents(agent, setting, value, small, tmp_path):
    run = train_config(small(agent, settings={f"agent.{setting}": value}), tmp_path / "run").run
    events = EventAccumulator(str(run.folder / "tensorboard")).Reload().PluginTagToContent("hparams")
    assert "_hparams_/experiment" not in events, "its list of columns would hide those of other agents"
    hyperparameters = events["_hparams_/session_start_info"]
    assert f"agent.{setting}".encode() in hyperparameters
    assert b"train.total_timesteps" in hyperparameters


@pytest.mark.parametrize("agent", ["qlearn", "ppo"])
def test_verbose_prints_a_line_for_each_episode(agent, small, tmp_path, capsys):
    settings = {"agent.n_steps": 16, "agent.batch_size": 32} if agent == "ppo" else {}
    done = train_config(small(agent, settings=settings, total_timesteps=400), tmp_path / "run", verbose=1)
    pattern = r"^EP: (\d+) - \[alpha: \S+ - gamma: \S+.*\] - Reward: (-?\d+) - Steps: (\d+) - Time: 0:00:\d\d$"
    lines = re.findall(pattern, capsys.readouterr().out, re.MULTILINE)
    assert [int(number) for number, _, _ in lines] == list(range(1, len(done.episode_lengths) + 1)) != []
    assert [int(steps) for _, _, steps in lines] == done.episode_lengths


def test_the_scores_are_the_mean_length_and_the_mean_of_the_100_longest():
    assert tutorial_scores(range(1, 201)) == "overall score: 100.5 steps, best 100 score: 150.5 steps"
    assert tutorial_scores([3, 5]) == "overall score: 4.0 steps, best 2 score: 4.0 steps"
    assert tutorial_scores([]) == "no episode ended"
