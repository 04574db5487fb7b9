"""Agents, tasks, robots and simulators by name, from this package, from another one, and by module:Name."""

import sys

import pytest

from tb2rl import Agent, evaluate, load, make_env, train
from tb2rl.commands.benchmark import learners
from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import agent_names, import_object, robot_names, simulator_names, task_names
from tb2rl.robots.robot import find_robot
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.runs.config import resolve
from tb2rl.simulation import find_simulator
from tb2rl.tasks import Task
from tb2rl.tasks.task import find_task
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.registry import find_world

STRANGER = """
from dataclasses import replace

from tb2rl import Agent
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.tasks.wander import Wander

AGENT = Agent("stable_baselines3:A2C", observation="discrete")
ARGO = replace(ROBOT, name="argo")

class Odyssey(Wander):
    pass

class Slow(KinematicSimulator):
    title = "simulator of slow robots"

    def step(self, commands, duration, inactive=None):
        return super().step(0.5 * commands, duration, inactive)
"""
ENTRY_POINTS = """
[tb2rl.agents]
stranger = stranger:AGENT
qlearn = stranger:AGENT
[tb2rl.tasks]
odyssey = stranger:Odyssey
maze = stranger:AGENT
[tb2rl.robots]
argo = stranger:ARGO
turtlebot2 = stranger:AGENT
[tb2rl.simulators]
slow = stranger:Slow
bullet = stranger:AGENT
"""


@pytest.fixture
def stranger(write_package):
    """An installed package with an agent, a task, a robot and a simulator."""
    write_package(ENTRY_POINTS, stranger=STRANGER)


def test_built_in_objects_are_found_by_their_names():
    assert {"dqn", "ppo", "qlearn", "random", "recurrent_ppo", "sac", "td3", "wallfollower"} <= set(agent_names())
    assert {"drive", "maze", "my-maze", "wall"} <= set(task_names())
    for agent in map(find_agent, agent_names()):
        assert isinstance(import_object(agent.algorithm or agent.policy), type)
    assert all(issubclass(find_task(name), Task) for name in task_names())
    assert [find_robot(name).name for name in robot_names()] == robot_names()
    assert [find_simulator(name).name for name in simulator_names()] == simulator_names()
    assert find_task(Wander) is Wander, "a task may be the class itself"


def test_objects_of_another_package_are_found_and_built_in_names_win(stranger):
    assert simulator_names()[-1] == "slow"
    assert find_agent("stranger") == Agent("stable_baselines3:A2C", observation="discrete")
    assert find_task("odyssey").__name__ == "Odyssey"
    assert find_robot("argo").name == "argo"
    for find, name in ((find_task, "odyssey"), (find_simulator, "slow")):
        with pytest.raises(InputError, match=f"did you mean '{name}'"):
            find(name[:-1])
    assert (find_agent("qlearn").policy, find_task("maze").__name__) == ("QTable", "Wander")
    assert (find_robot("turtlebot2"), find_simulator("bullet").title) == (ROBOT, "PyBullet")


def test_a_simulator_of_another_package_trains_evaluates_and_makes_environments(stranger, tmp_path):
    name, env = "slow", make_env("maze", "raw", simulation="stranger:Slow", start="fixed")
    env.reset(seed=0)
    for _ in range(5):
        info = env.step(0)[-1]
    assert 0.1 < info["distance"] < 0.25, "half of 0.5 m"
    short = {"simulation": name, "eval_simulation": name, "n_envs": 2, "total_timesteps": 32, "eval_freq": 16}
    policy = train("qlearn", folder=tmp_path / "run", eval_episodes=2, eval_steps=5, **short)
    evaluation = evaluate(policy, episodes=2, steps=5, simulation=name)
    assert (evaluation.simulation, load(tmp_path / "run").trained_with.train.simulation) == (name, name)


def test_a_class_variable_of_a_task_is_no_setting(write_package):
    head = "from __future__ import annotations\nfrom typing import ClassVar\nfrom tb2rl.tasks.wander import Wander\n"
    fine, bare = "class Fine(Wander):\n    colour: ClassVar[str] = ''\n", "class Bare(Wander):\n    colour: str = ''\n"
    write_package("", my_task=head + fine + bare)
    assert find_task("my_task:Fine").colour == ""
    with pytest.raises(InputError, match=r"settings colour, so it needs @dataclass\(frozen=True\)"):
        find_task("my_task:Bare")


def test_a_missing_package_of_an_agent_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)  # as if it were not installed
    assert "recurrent_ppo" in agent_names()
    with pytest.raises(InputError, match=r"no module 'sb3_contrib'; pip install sb3-contrib brings it$"):
        resolve("recurrent_ppo")
    assert learners() == ["dqn", "ppo", "qlearn"], "sac and td3 need continuous actions"


def test_a_reference_that_does_not_fit_is_refused():
    names = {"stable_baselines4:A2C": "stable_baselines4", "stable_baselines3:A2D": "'A2D'", ":A2C": ":A2C"}
    kinds = {find_agent: "a tb2rl.Agent", find_task: "tb2rl.tasks.Task", find_simulator: "neither a SimulatorType"}
    for find, kind in {**kinds, find_robot: None}.items():
        for name, named in {**names, "pathlib:Path": kind}.items():
            with pytest.raises(InputError, match=named):
                find(name)


def test_an_error_inside_a_users_module_shows_as_it_is(write_package):
    write_package("", my_broken_agent="import a_package_that_is_missing\n")
    with pytest.raises(ModuleNotFoundError, match="a_package_that_is_missing"):
        find_agent("my_broken_agent:Mine")


@pytest.mark.parametrize(("find", "kind"), [(find_agent, "agent"), (find_world, "world")])
def test_a_module_with_its_ending_is_refused_with_the_right_words(find, kind):
    words = rf"^{kind}: cannot import 'errand\.py:IT': .* module:Class, without \.py or \.__main__$"
    with pytest.raises(InputError, match=words):
        find("errand.py:IT")
