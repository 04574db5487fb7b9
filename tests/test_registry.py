"""Agents, tasks and robots by name, from this package, from another one, and by module:Name."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tb2rl import load, train
from tb2rl.commands.benchmark import learners
from tb2rl.core.agent import Agent, find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import agent_names, import_object, robot_names, task_names
from tb2rl.robots import Robot
from tb2rl.robots.registry import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.runs.layers import resolve
from tb2rl.tasks import Task
from tb2rl.tasks.registry import find_task
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.registry import find_world


def run(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_built_in_agents_tasks_and_robots_are_found_by_their_names():
    assert {"dqn", "ppo", "qlearn", "random", "recurrent_ppo", "sac", "td3", "wallfollower"} <= set(agent_names())
    assert {"drive", "maze", "my-maze", "wall"} <= set(task_names())
    assert not [name for name in agent_names() if name.startswith("_")], "helpers are not agents"
    for name in agent_names():
        agent = find_agent(name)
        assert agent.observation in ("discrete", "raw")
        assert isinstance(import_object(agent.algorithm or agent.policy), type)
    for name in task_names():
        assert issubclass(find_task(name), Task)
    for name in robot_names():
        assert find_robot(name).name == name


def test_listing_names_imports_nothing_heavy():
    imports = "from tb2rl.core.plugins import agent_names, robot_names, task_names; agent_names(), robot_names()"
    heavy = "torch", "stable_baselines3", "pybullet", "tensorboard", "numba", "pydantic"
    assert run(f"import sys; {imports}; task_names(); print([m for m in {heavy} if m in sys.modules])").strip() == "[]"


@pytest.mark.slow
def test_the_functions_of_the_package_are_functions_whatever_was_imported_before():
    shown = "print([name for name in tb2rl.__all__ if not callable(getattr(tb2rl, name))])"
    assert run(f"import tb2rl.train, tb2rl.evaluate; {shown}") == "[]\n"


def test_a_task_may_be_the_class_itself():
    assert find_task(Wander) is Wander
    with pytest.raises(InputError, match=r"not a class derived from tb2rl\.tasks\.Task"):
        find_task(Robot)


@pytest.mark.parametrize(
    ("top", "written"),
    [("", "ClassVar[str]"), ("from __future__ import annotations\n", "typing.ClassVar[str]"), ("", "ClassVar")],
)
def test_a_class_variable_of_a_task_is_no_setting(top, written, write_package):
    head = f"{top}import typing\nfrom typing import ClassVar\nfrom tb2rl.tasks.wander import Wander\n"
    lines = "class {}(Wander):\n    {}: {} = 'red'\n"
    write_package("", my_task=head + lines.format("Fine", "colour", written) + lines.format("Bare", "colour", "str"))
    try:
        assert find_task("my_task:Fine").colour == "red"
        with pytest.raises(InputError, match=r"settings colour, so it needs @dataclass\(frozen=True\)"):
            find_task("my_task:Bare")
    finally:
        del sys.modules["my_task"]


# ---- of another package


def test_agents_tasks_and_robots_of_another_package_are_found(write_package):
    agent = "from tb2rl import Agent\nAGENT = Agent('stable_baselines3:A2C', observation='discrete')\n"
    task = "from tb2rl.tasks.wander import Wander\nclass Odyssey(Wander): pass\n"
    robot = (
        "from dataclasses import replace\nfrom tb2rl.robots.turtlebot2 import ROBOT\nARGO = replace(ROBOT, name='argo')"
    )
    write_package(
        "[tb2rl.agents]\nstranger = stranger_agent:AGENT\nqlearn = stranger_agent:AGENT\n"
        "[tb2rl.tasks]\nodyssey = stranger_task:Odyssey\nmaze = stranger_agent:AGENT\n"
        "[tb2rl.robots]\nargo = stranger_robot:ARGO\nturtlebot2 = stranger_agent:AGENT\n",
        stranger_agent=agent,
        stranger_task=task,
        stranger_robot=robot,
    )
    assert {"stranger", "qlearn"} <= set(agent_names())
    assert {"odyssey", "maze"} <= set(task_names())
    assert {"argo", "turtlebot2"} <= set(robot_names())
    assert find_agent("stranger") == Agent("stable_baselines3:A2C", observation="discrete")
    assert find_task("odyssey").__name__ == "Odyssey"
    assert find_robot("argo").name == "argo"
    nearly = (find_agent, "strange", "stranger"), (find_task, "odysey", "odyssey"), (find_robot, "arg", "argo")
    for find, name, near in nearly:
        with pytest.raises(InputError, match=f"did you mean '{near}'"):
            find(name)
    assert (find_agent("qlearn").policy, find_task("maze").__name__) == ("QTable", "Wander"), "built-in names win"
    assert find_robot("turtlebot2") is ROBOT


# ---- by module and name


def test_a_missing_package_of_an_agent_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)  # as if it were not installed
    assert "recurrent_ppo" in agent_names()
    with pytest.raises(InputError, match=r"no module 'sb3_contrib'; pip install sb3-contrib brings it$"):
        resolve("recurrent_ppo")
    assert "recurrent_ppo" not in learners()


def test_an_algorithm_by_module_and_class_trains(tmp_path):
    settings = {"total_timesteps": 32, "n_envs": 1, "eval_freq": 0, "simulation": "kinematic"}
    trained = train("stable_baselines3:A2C", settings={"agent.n_steps": 8}, folder=tmp_path / "run", **settings)
    assert (type(trained).__name__, trained.num_timesteps, trained.n_steps) == ("A2C", 32, 8)
    assert type(load(tmp_path / "run")) is type(trained)


def test_a_reference_to_a_built_in_object_is_what_its_name_means():
    assert find_agent("tb2rl.agents.qlearn:AGENT") == find_agent("qlearn")
    assert find_task("tb2rl.tasks.wander:Wander") is find_task("maze")
    assert find_robot("tb2rl.robots.turtlebot2:ROBOT") is find_robot("turtlebot2")


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("stable_baselines4:A2C", "stable_baselines4"),
        ("stable_baselines3:A2D", "'A2D'"),
        ("stable_baselines3.nowhere:A2C", "stable_baselines3.nowhere"),
        ("pathlib:Path", "Stable-Baselines3 algorithm"),
        (":A2C", ":A2C"),
        ("stable_baselines3:", "stable_baselines3:"),
        ("..agents:A2C", "..agents:A2C"),
    ],
)
def test_a_reference_that_does_not_fit_is_refused(name, named):
    with pytest.raises(InputError, match=named):
        find_agent(name)
    for find in (find_task, find_robot):
        with pytest.raises(InputError):
            find(name)


def test_an_error_inside_a_users_module_shows_as_it_is(tmp_path, monkeypatch):
    (tmp_path / "my_broken_agent.py").write_text("import a_package_that_is_missing\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="a_package_that_is_missing"):
        find_agent("my_broken_agent:Mine")


@pytest.mark.parametrize(
    ("find", "kind"), [(find_task, "task"), (find_agent, "agent"), (find_robot, "robot"), (find_world, "world")]
)
def test_a_module_with_its_ending_is_refused_with_the_right_words(find, kind):
    with pytest.raises(InputError, match=rf"^{kind}: cannot import 'errand\.py:IT': .* write errand:IT$"):
        find("errand.py:IT")
