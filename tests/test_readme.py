"""What the README shows works as it stands there."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import tb2rl
from tb2rl.registry import Agent
from tb2rl.tasks import Task

README = Path(__file__).parent.parent / "README.md"
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)


def block(containing: str) -> str:
    found = [text for _, text in BLOCKS if containing in text]
    assert len(found) == 1
    return found[0]


def test_the_task_of_the_readme_is_a_task():
    names: dict = {}
    exec(block("class MyTurtleBot2Maze"), names)
    task = names["MyTurtleBot2Maze"]
    assert issubclass(task, Task)
    assert tb2rl.make_env(task, simulation="kinematic").action_space.n == 4


def test_the_agent_of_the_readme_is_an_agent():
    names: dict = {}
    exec(block("AGENT = Agent("), names)
    assert isinstance(names["AGENT"], Agent)


def test_the_drawing_of_the_readme_is_a_maze_to_train_in(tmp_path):
    (tmp_path / "my_maze.txt").write_text(block("#S"))
    env = tb2rl.make_env("maze", maze=str(tmp_path / "my_maze.txt"), simulation="kinematic")
    env.reset(seed=0)
    assert env.maze.goal is not None
    assert min(env.maze.clearance(*env.maze.random_poses(np.random.default_rng(0), 1, 0.6)[0, :2]) for _ in "ab") >= 0.6


def test_every_picture_of_the_readme_is_there():
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README.read_text(encoding="utf-8"))
    assert pictures
    assert [name for name in pictures if not (README.parent / name).is_file()] == []


@pytest.mark.parametrize("link", re.findall(r"[^!]\[[^\]]+\]\((?!http)([^)]+)\)", README.read_text(encoding="utf-8")))
def test_every_link_of_the_readme_leads_somewhere(link):
    assert (README.parent / link).exists()


def test_the_results_of_the_readme_are_those_of_the_zoo():
    keeper = import_module("tb2rl.zoo.__main__")
    assert keeper.overview(keeper.entries()) in README.read_text(encoding="utf-8")
