"""Every agent that learns, learns the default maze: trained in the fast twin, judged in PyBullet."""

from __future__ import annotations

import pytest

from tb2rl import evaluate, train
from tb2rl.benchmark import learners


@pytest.mark.slow
@pytest.mark.parametrize("agent", learners())
def test_it_learns_to_drive(agent, tmp_path):
    policy = train(agent, simulation="kinematic", seed=7, eval_freq=0, folder=tmp_path / "run")
    summary = evaluate(policy, episodes=40, steps=1000).summary()
    assert summary["crash_free_rate"] >= 0.95
    assert summary["mean_speed"] > 0.3  # nor does it stand and turn
