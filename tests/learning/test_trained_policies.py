"""Every agent that learns, learns the default task: trained in the fast twin, evaluated in PyBullet."""

from __future__ import annotations

import pytest

from tb2rl import evaluate, train
from tb2rl.registry import agent_names, find_agent


@pytest.mark.slow
@pytest.mark.parametrize("agent", [name for name in agent_names() if find_agent(name).algorithm is not None])
def test_it_learns_to_drive(agent, tmp_path):
    policy = train(agent, simulation="kinematic", seed=7, eval_freq=0, folder=tmp_path / "run")
    summary = evaluate(policy, episodes=40, steps=1000).summary()
    assert summary["failure_free_rate"] >= 0.95
    assert summary["mean_speed"] > 0.3  # nor does it stand and turn
