"""A training as the 2018 tutorial's, in its own words, against our robot and no Gazebo."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

RATE, EPISODES, STEPS = 5, 20, 30
ACTION = 0.1  # [s] of wall-clock time that an action lasts: there 0.2, and 10 000 steps in place of 30
ROOM = "walls: [{path: [[-1.5, -1.5], [1.5, -1.5], [1.5, 1.5], [-1.5, 1.5]], closed: true}]\nstart: [0, 0, 0]\n"


@pytest.mark.slow
def test_the_tutorials_calls_in_its_order_train_twenty_episodes(graph1):
    with graph1.command("ros", "messages", "messages") as written:  # as FROM_ROS.md says
        assert written.wait() == 0, written.errors
    program = Path(__file__).with_name("tutorial.py")
    (graph1.folder / "room.yaml").write_text(ROOM)
    room = ["--task", "maze", "--set", "task.world=room.yaml"]
    with graph1.start("simulate", "--rate", str(RATE), *room) as simulated:
        training = graph1.run(program, str(EPISODES), str(STEPS), str(ACTION))
        assert simulated.stop() == 0
    *episodes, end = map(json.loads, training)
    assert len(episodes) == EPISODES
    assert all(1 <= episode["steps"] <= STEPS for episode in episodes)
    assert all(episode["done"] == (episode["reward"] < 0) for episode in episodes)
    assert any(episode["done"] for episode in episodes)
    assert len({episode["x"] for episode in episodes}) > 1, "it moves"
    assert all(len(episode["state"]) == 5 for episode in episodes)
    assert end["values"] >= 3
    records = simulated.lines[1:]
    assert len(records) >= EPISODES
    assert all(record.startswith("from (0.00, 0.00, 0.00): ") for record in records)
