"""Agents, tasks, robots and simulators by name, from this package, from another one, and by module:Name."""

from __future__ import annotations

import sys

import pytest

from tb2rl import Agent, evaluate, load, make_env, train
from tb2rl.commands.benchmark import learners
from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import agent_names, import_object, robot_names, simulator_names, task_names
from tb2rl.robots import Robot
from tb2rl.robots.registry import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.runs.layers import resolve
from tb2rl.simulation import find_simulator
from tb2rl.tasks import Task
from tb2rl.tasks.registry import find_task
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.registry import find_world

AGENT = "from tb2rl import Agent\nAGENT = Agent('stable_baselines3:A2C', observation='discrete')\n"
TASK = "from tb2rl.tasks.wander import Wander\nclass Odyssey(Wander): pass\n"
ROBOTS = (
    "from dataclasses import replace\nfrom tb2rl.robots.turtlebot2 import ROBOT\nARGO = replace(ROBOT, name='argo')\n"
)
SIMULATOR = """
from tb2rl.simulation.kinematic.simulator import KinematicSimulator

class Slow(KinematicSimulator):
    title = "simulator of slow robots"

    def step(self, commands, duration, skip=None):
        return super().step(0.5 * commands, duration, skip)
"""
ENTRY_POINTS = """
[tb2rl.agents]
stranger = stranger_agent:AGENT
qlearn = stranger_agent:AGENT
[tb2rl.tasks]
odyssey = stranger_task:Odyssey
maze = stranger_agent:AGENT
[tb2rl.robots]
argo = stranger_robot:ARGO
turtlebot2 = stranger_agent:AGENT
[tb2rl.simulators]
slow = stranger_simulator:Slow
bullet = stranger_agent:AGENT
"""


@pytest.fixture
def stranger(write_package):
    """An installed package with an agent, a task, a robot and a simulator."""
    modules = {"agent": AGENT, "task": TASK, "robot": ROBOTS, "simulator": SIMULATOR}
    write_package(ENTRY_POINTS, **{f"stranger_{name}": code for name, code in modules.items()})
    yield
    for name in modules:
        sys.modules.pop(f"stranger_{name}", None)


def test_built_in_objects_are_found_by_their_names():
    assert {"dqn", "ppo", "qlearn", "random", "recurrent_ppo", "sac", "td3", "wallfollower"} <= set(agent_names())
    assert {"drive", "maze", "my-maze", "wall"} <= set(task_names())
    assert not [name for name in agent_names() if name.startswith("_")], "helpers are not agents"
    for name in agent_names():
        agent = find_agent(name)
        assert agent.observation in ("discrete", "raw")
        assert isinstance(import_object(agent.algorithm or agent.policy), type)
    for name in task_names():
        assert issubclass(find_task(name), Task)
    assert [find_robot(name).name for name in robot_names()] == robot_names()
    assert [find_simulator(name).name for name in simulator_names()] == simulator_names()


def test_objects_of_another_package_are_found_and_built_in_names_win(stranger):
    assert {"stranger", "qlearn"} <= set(agent_names())
    assert simulator_names()[-1] == "slow"
    assert find_agent("stranger") == Agent("stable_baselines3:A2C", observation="discrete")
    assert find_task("odyssey").__name__ == "Odyssey"
    assert find_robot("argo").name == "argo"
    nearly = (find_agent, "strange", "stranger"), (find_task, "odysey", "odyssey"), (find_robot, "arg", "argo")
    for find, name, near in (*nearly, (find_simulator, "slo", "slow")):
        with pytest.raises(InputError, match=f"did you mean '{near}'"):
            find(name)
    assert (find_agent("qlearn").policy, find_task("maze").__name__) == ("QTable", "Wander")
    assert (find_robot("turtlebot2"), find_simulator("bullet").title) == (ROBOT, "PyBullet")


@pytest.mark.parametrize("name", ["slow", "stranger_simulator:Slow"])
def test_a_simulator_of_another_package_trains_evaluates_and_makes_environments(name, stranger, tmp_path):
    env = make_env("maze", "raw", simulation=name, start="fixed")
    env.reset(seed=0)
    for _ in range(5):
        info = env.step(0)[-1]
    assert 0.1 < info["distance"] < 0.25, "half of 0.5 m"
    short = {"simulation": name, "eval_simulation": name, "n_envs": 2, "total_timesteps": 32, "eval_freq": 16}
    policy = train("qlearn", folder=tmp_path / "run", eval_episodes=2, eval_steps=5, **short)
    evaluation = evaluate(policy, episodes=2, steps=5, simulation=name)
    assert (evaluation.simulation, load(tmp_path / "run").trained_with.train.simulation) == (name, name)


def test_a_class_without_steps_is_no_simulator(stranger):
    with pytest.raises(InputError, match="neither a SimulatorType nor a class with reset and step"):
        find_simulator("stranger_task:Odyssey")


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


def test_a_missing_package_of_an_agent_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)  # as if it were not installed
    assert "recurrent_ppo" in agent_names()
    with pytest.raises(InputError, match=r"no module 'sb3_contrib'; pip install sb3-contrib brings it$"):
        resolve("recurrent_ppo")
    assert "recurrent_ppo" not in learners()


def test_a_reference_to_a_built_in_object_is_what_its_name_means():
    assert find_agent("tb2rl.agents.qlearn:AGENT") == find_agent("qlearn")
    assert find_task("tb2rl.tasks.wander:Wander") is find_task("maze")
    assert find_robot("tb2rl.robots.turtlebot2:ROBOT") is find_robot("turtlebot2")
    assert find_simulator("tb2rl.simulation.bullet:SIMULATOR") is find_simulator("bullet")


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("stable_baselines4:A2C", "stable_baselines4"),
        ("stable_baselines3:A2D", "'A2D'"),
        ("stable_baselines3.nowhere:A2C", "stable_baselines3.nowhere"),
        ("pathlib:Path", "Stable-Baselines3 algorithm"),
        (":A2C", ":A2C"),
        ("..agents:A2C", "..agents:A2C"),
    ],
)
def test_a_reference_that_does_not_fit_is_refused(name, named):
    with pytest.raises(InputError, match=named):
        find_agent(name)
    for find in (find_task, find_robot, find_simulator):
        with pytest.raises(InputError):
            find(name)


def test_an_error_inside_a_users_module_shows_as_it_is(write_package):
    write_package("", my_broken_agent="import a_package_that_is_missing\n")
    with pytest.raises(ModuleNotFoundError, match="a_package_that_is_missing"):
        find_agent("my_broken_agent:Mine")


@pytest.mark.parametrize(
    ("find", "kind"), [(find_task, "task"), (find_agent, "agent"), (find_robot, "robot"), (find_world, "world")]
)
def test_a_module_with_its_ending_is_refused_with_the_right_words(find, kind):
    with pytest.raises(InputError, match=rf"^{kind}: cannot import 'errand\.py:IT': .* write errand:IT$"):
        find("errand.py:IT")
