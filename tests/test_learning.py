"""The default agent learns the default maze: trained in the fast twin, judged in PyBullet."""

from __future__ import annotations

import pytest

from tb2rl import evaluate, train


@pytest.mark.slow
def test_the_table_learns_to_drive(tmp_path):
    policy = train("qlearn", simulation="kinematic", n_envs=64, eval_freq=0, folder=tmp_path / "run")
    summary = evaluate(policy, episodes=40, steps=1000).summary()
    assert summary["crash_free_rate"] >= 0.85
    assert summary["mean_speed"] > 0.3  # nor does it stand and turn
