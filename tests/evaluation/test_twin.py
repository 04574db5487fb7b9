"""Episodes that are driven together, all of them in the twin, are those that each robot would have driven alone."""

from __future__ import annotations

import time

import numpy as np
import pytest
import torch as th

from tb2rl import load
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.evaluation.evaluation import Evaluation, episode_of
from tb2rl.evaluation.evaluator import TOGETHER, Evaluator
from tb2rl.evaluation.rollout import roll_out
from tb2rl.evaluation.twin import TwinEvaluator
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.config import Config
from tb2rl.runs.layers import resolve


def learner(config: Config, **weights):
    """An untrained policy that does not do the same everywhere."""
    policy = make_algorithm(config, Spaces.vectorised(config)).policy
    th.manual_seed(0)
    if hasattr(policy, "q"):
        policy.q[:] = th.rand(policy.q.shape, dtype=th.float64)
    for parameter in policy.parameters() if not hasattr(policy, "q") else ():
        th.nn.init.normal_(parameter, std=0.3)  # small: what rounding changes is not to grow
    return policy


def check_against_robots_alone(evaluation: Evaluation, policy) -> None:
    env = TurtleBot2Env(evaluation.scene, simulation=evaluation.simulation)
    for i, together in enumerate(evaluation.episodes):
        place = {"pose": together.start, "world": together.world}
        alone = episode_of(evaluation.scene, list(roll_out(env, policy, evaluation.seed + i, **place)))
        assert together.actions.dtype == alone.actions.dtype
        np.testing.assert_allclose(together.actions, alone.actions, atol=1e-3)  # float32, summed in another order
        assert together.path.shape == alone.path.shape == (alone.length + 1, 2)
        np.testing.assert_allclose(together.path, alone.path, atol=1e-3)
        for figure in ("ended", "failed", "success", "touched", "length", "world"):
            assert getattr(together, figure) == getattr(alone, figure), figure
        assert together.distance == pytest.approx(alone.distance, abs=1e-3)
        assert together.episode_return == pytest.approx(alone.episode_return, rel=1e-4)


POLICIES = {
    "table": ("qlearn", "maze", {}),
    "dqn": ("dqn", "maze", {"agent.policy_kwargs.net_arch": [8]}),
    "ppo": ("ppo", "wall", {"agent.policy_kwargs.net_arch": [8]}),
    "recurrent": ("sb3_contrib:RecurrentPPO", "maze", {"agent.policy_kwargs.lstm_hidden_size": 8, "train.n_envs": 1}),
    "continuous": ("stable_baselines3:SAC", "cruise", {"agent.policy_kwargs.net_arch": [8]}),
    "worlds": (
        "ppo",
        "wall",
        {"agent.policy_kwargs.net_arch": [8], "task.world": "cells", "task.start_clearance": 0.3},
    ),
    "images": ("stable_baselines3:A2C", "pictured", {"task.observation": "raw"}),
}


SLOW = {"recurrent", "images"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in POLICIES])
def test_every_episode_is_the_one_that_a_robot_drives_alone(name, request):
    agent, task, settings = POLICIES[name]
    task = request.getfixturevalue(task) if task in ("cruise", "pictured") else task
    config = resolve(agent, task, settings=settings)
    policy = learner(config)
    with TwinEvaluator(config.scene, episodes=12, steps=40, seed=3) as evaluator:
        evaluation = evaluator.run(policy)
    assert (evaluation.simulation, evaluation.seed, evaluation.steps) == ("kinematic", 3, 40)
    assert len({episode.start for episode in evaluation.episodes}) == 12
    check_against_robots_alone(evaluation, policy)
    endings = {episode.ended for episode in evaluation.episodes}
    if name == "table":
        assert endings == {"collision", "time limit"}, "some robots begin anew before the others are done"


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in POLICIES])
def test_an_episode_of_a_group_is_the_one_that_a_robot_drives_alone(name, request):
    agent, task, settings = POLICIES[name]
    task = request.getfixturevalue(task) if task in ("cruise", "pictured") else task
    config = resolve(agent, task, settings=settings)
    policy = learner(config)
    with Evaluator(config.scene, episodes=TOGETHER + 1, steps=15, workers=1) as evaluator:  # rounding grows in physics
        evaluation = evaluator.run(policy)
        rest = list(evaluator.drive(policy, first=TOGETHER - 1))
    check_against_robots_alone(evaluation, policy)
    assert [each.actions.tolist() for each in rest] == [each.actions.tolist() for each in evaluation.episodes[-2:]]


def test_the_same_evaluation_twice_gives_the_same_result(outcomes):
    config = resolve("qlearn", settings={"task.laser_noise": 0.01})
    policy = learner(config)
    with TwinEvaluator(config.scene, 20, 50, seed=1) as evaluator:
        first, again = evaluator.run(policy), evaluator.run(policy)
    with TwinEvaluator(config.scene, 20, 50, seed=2) as evaluator:
        other = evaluator.run(policy)
    assert outcomes(first) == outcomes(again) != outcomes(other)


def test_it_agrees_with_the_judge_on_a_trained_policy():
    policy = load("zoo:maze-loop-dqn")
    with TwinEvaluator(policy.trained_with.scene, episodes=50, steps=200, seed=5) as evaluator:
        summary = evaluator.run(policy.policy).summary()
    assert summary["failure_free_rate"] >= 0.96
    assert summary["mean_speed"] == pytest.approx(0.44, abs=0.03)
    assert summary["median_squares"] > 5


def test_a_bar_does_not_change_the_result(outcomes):
    config = resolve("qlearn")
    policy = learner(config)
    with TwinEvaluator(config.scene, 3, 10, seed=1) as evaluator:
        assert outcomes(evaluator.run(policy, progress=True)) == outcomes(evaluator.run(policy))


@pytest.mark.slow
def test_a_thousand_episodes_of_a_table_take_less_than_two_seconds():
    policy = load("zoo:maze-loop-qlearn")
    seconds = []
    with TwinEvaluator(policy.trained_with.scene, 1000, 1000, seed=1) as evaluator:
        for _ in range(4):
            started = time.process_time()
            evaluator.run(policy.policy)
            seconds.append(time.process_time() - started)
    print("seconds of one processor:", seconds)
    assert min(seconds) < 2.0
