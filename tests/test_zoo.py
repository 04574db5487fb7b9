"""Every policy of the zoo loads, drives and is what its evaluation says."""

from __future__ import annotations

import json

import pytest

import tb2rl
from tb2rl.settings import room

POLICIES = sorted(entry.name for entry in room("zoo").iterdir() if (entry / "config.yaml").is_file())


def test_there_are_policies():
    assert {"maze-loop-qlearn", "maze-loop-dqn", "maze-loop-ppo"} <= set(POLICIES)


@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_drives_its_maze(name):
    policy = tb2rl.load(f"zoo:{name}")
    env = tb2rl.make_env(policy)
    observation, _ = env.reset(seed=2)
    for _ in range(200):
        action, _ = policy.predict(observation, deterministic=True)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated
    assert info["distance"] > 10.0


@pytest.mark.slow
@pytest.mark.parametrize("name", POLICIES)
def test_the_first_episodes_are_the_ones_on_record(name):
    record = json.loads((room("zoo") / name / "evaluation.json").read_text())["each"][:5]
    again = tb2rl.evaluate(f"zoo:{name}", episodes=5)
    for episode, noted in zip(again.episodes, record, strict=True):
        assert (episode.ended, episode.length) == (noted["ended"], noted["length"])
        assert episode.distance == pytest.approx(noted["distance"], abs=1.0)
