"""A training as the 2018 tutorial's, by its own calls, against our robot in the place of Gazebo."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

DEBIANS_PYTHON = "/usr/bin/python3"
RATE, EPISODES, STEPS = 5, 12, 30
ACTION = 0.1  # [s] of wall-clock time that an action lasts: there 0.2, and 10 000 steps in place of 30
ROOM = "walls: [{path: [[-1.5, -1.5], [1.5, -1.5], [1.5, 1.5], [-1.5, 1.5]], closed: true}]\nstart: [0, 0, 0]\n"


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)  # in real time
def test_the_tutorials_calls_in_its_order_drive_episodes(graph1):
    with graph1.command("ros", "messages", "messages") as written:  # as FROM_ROS.md says
        assert written.wait() == 0, written.errors
    program = Path(__file__).with_name("tutorial.py")
    (graph1.folder / "room.yaml").write_text(ROOM)
    with graph1.start("simulate", "--rate", str(RATE), "--set", "task.world=room.yaml") as simulated:
        command = [DEBIANS_PYTHON, str(program), str(EPISODES), str(STEPS), str(ACTION)]
        with graph1.process(command) as training:
            assert training.wait() == 0, training.errors
        episodes = [json.loads(line) for line in training.lines]
        assert simulated.stop() == 0
    assert len(episodes) == EPISODES
    assert all(1 <= episode["steps"] <= STEPS for episode in episodes)
    assert all(episode["done"] == (episode["reward"] < 0) for episode in episodes)
    assert any(episode["done"] for episode in episodes)
    assert len({episode["x"] for episode in episodes}) > 1, "it moves"
    assert all(len(episode["state"]) == 5 for episode in episodes)
    records = simulated.lines[1:]
    assert len(records) >= EPISODES
    assert all(record.startswith("from (0.00, 0.00, 0.00): ") for record in records)
