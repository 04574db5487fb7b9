"""The task that students copy."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.tasks.my_turtlebot2_maze import MyTurtleBot2Maze

FAR = 3.0
SOURCE = Path(importlib.util.find_spec("tb2rl.tasks.my_turtlebot2_maze").origin)


def test_my_turtlebot2_maze_has_a_fourth_action_that_costs(make_robot_state):
    task = MyTurtleBot2Maze()
    after = make_robot_state([FAR, FAR, FAR, FAR, 0.4])
    outcome = task.outcome(after, np.array([0, 1, 2, 3, 3]), after)
    assert outcome.reward.tolist() == [5, 1, 1, -5, -200]
    assert outcome.failed["collision"].tolist() == [False] * 4 + [True]
    assert task.actions.names == ("forward", "left", "right", "backward")
    assert task.actions.table[3].tolist() == [-0.05, 0]


def test_a_copy_of_the_file_is_a_task_of_ones_own(tmp_path, monkeypatch):
    changed = SOURCE.read_text().replace("backward_reward: float = -5.0", "backward_reward: float = -7.0")
    (tmp_path / "my_copied_task.py").write_text(changed)
    monkeypatch.syspath_prepend(tmp_path)
    env = make_env("my_copied_task:MyTurtleBot2Maze", world="circuit", start="fixed", backward_speed=-0.1)
    env.reset()
    _, reward, _, _, info = env.step(env.task.actions.backward)
    env.close()
    assert env.action_space.n == 4
    assert reward == -7.0
    assert info["pose"][0] == pytest.approx(env.scene.world.start[0] - info["distance"], abs=1e-4)
    assert info["distance"] > 0.01
