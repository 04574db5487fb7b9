"""A training as the 2018 tutorial's, by its own calls, against our robot in the place of Gazebo."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

DEBIANS_PYTHON = "/usr/bin/python3"
MD5 = "97e2057080558ce4730434b5fae75c91"  # of gazebo_msgs/SetPhysicsProperties, wherever it was made
EPISODES, STEPS = 12, 30
ACTION = 0.1  # [s] of wall-clock time that an action lasts: there 0.2, and 10 000 steps in place of 30
ROOM = "walls: [{path: [[-1.5, -1.5], [1.5, -1.5], [1.5, 1.5], [-1.5, 1.5]], closed: true}]\nstart: [0, 0, 0]\n"


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)  # in real time
def test_the_tutorials_calls_in_its_order_drive_episodes(graph1):
    with graph1.command("ros", "messages", "messages") as written:  # as FROM_ROS.md says
        assert written.wait() == 0, written.errors
    (graph1.folder / "room.yaml").write_text(ROOM)
    tutorial = graph1.folder / "src" / "openai_ros"  # the written package does not shadow the tutorial's own
    tutorial.mkdir(parents=True)
    (tutorial / "__init__.py").touch()
    (tutorial / "robot_gazebo_env.py").write_text("class RobotGazeboEnv: pass\n")
    program = [DEBIANS_PYTHON, str(Path(__file__).with_name("tutorial.py")), str(EPISODES), str(STEPS), str(ACTION)]
    with graph1.start("simulate", "--rate", "5", "--set", "task.world=room.yaml") as simulated:
        with graph1.process(program, f"{graph1.folder / 'messages'}:{tutorial.parent}") as training:
            assert training.wait() == 0, training.errors
        assert simulated.stop() == 0
    *lines, md5 = training.lines
    assert md5 == MD5
    episodes = [json.loads(line) for line in lines]
    assert len(episodes) == EPISODES
    assert all(1 <= episode["steps"] <= STEPS and episode["readings"] == 720 for episode in episodes)
    assert any(episode["collided"] for episode in episodes)
    assert len({episode["x"] for episode in episodes}) > 1, "it moves"
    records = simulated.lines[1:]
    assert len(records) >= EPISODES
    assert all(record.startswith("from (0.00, 0.00, 0.00): ") for record in records)
