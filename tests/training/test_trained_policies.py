"""Every agent that learns, learns a task that it can do: trained in the fast twin, evaluated in PyBullet."""

from __future__ import annotations

import pytest

from tb2rl import evaluate, train
from tb2rl.core.agent import find_agent
from tb2rl.core.plugins import agent_names


@pytest.mark.slow
@pytest.mark.parametrize(
    ("agent", "task"),
    [
        (name, "maze")
        for name in agent_names()
        if find_agent(name).algorithm and find_agent(name).actions != "continuous"
    ]
    + [(name, "drive") for name in agent_names() if find_agent(name).algorithm and find_agent(name).actions != "named"],
)
def test_it_learns_to_drive(agent, task, tmp_path):
    fewer = {"train.eval_episodes": 100} if task == "drive" else {}  # no such training stops once they are good
    policy = train(agent, task, simulation="kinematic", seed=7, settings=fewer, folder=tmp_path / "run")
    summary = evaluate(policy, episodes=40, steps=1000).summary()
    assert summary["failure_free_rate"] >= 0.95
    assert summary["mean_speed"] > 0.3  # nor does it stand and turn
