"""Agents and tasks by name, from this package, from another one, and by module:Class."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tb2rl import load, train
from tb2rl.errors import InputError
from tb2rl.registry import Agent, agent_names, find_agent, find_task, import_object, task_names
from tb2rl.tasks import Task


def run(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def write_package(folder, entry_points: str, **modules: str) -> None:
    """A package as pip leaves it in site-packages."""
    info = folder / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entry_points)
    for name, code in modules.items():
        (folder / f"{name}.py").write_text(code)


def test_the_built_in_agents_and_tasks_have_names():
    assert {"dqn", "ppo", "qlearn", "random", "wallfollower"} <= set(agent_names())
    assert {"maze", "my-maze", "wall"} <= set(task_names())
    assert not [name for name in agent_names() if name.startswith("_")], "helpers are no agents"


@pytest.mark.parametrize("name", agent_names())
def test_every_agent_that_has_a_name_can_be_had(name):
    agent = find_agent(name)
    assert agent.observation in ("discrete", "raw")
    assert isinstance(import_object(agent.algorithm or agent.policy), type)


@pytest.mark.parametrize("name", task_names())
def test_every_task_that_has_a_name_can_be_had(name):
    assert issubclass(find_task(name), Task)


def test_names_cost_no_torch():
    code = "import sys, tb2rl; from tb2rl.registry import agent_names, task_names; agent_names(); task_names()"
    heavy = "torch", "stable_baselines3", "pybullet", "tensorboard"
    assert run(f"{code}; print([m for m in {heavy} if m in sys.modules])").strip() == "[]"


def test_the_functions_of_the_package_are_functions_whatever_was_imported_before():
    shown = "print([name for name in tb2rl.__all__ if not callable(getattr(tb2rl, name))])"
    assert run(f"import tb2rl.train, tb2rl.evaluate; {shown}") == "[]\n"


def test_agents_and_tasks_of_another_package_are_found(tmp_path, monkeypatch):
    points = "[tb2rl.agents]\nstranger = stranger_agent:AGENT\n[tb2rl.tasks]\nodyssey = stranger_task:Odyssey\n"
    agent = "from tb2rl.registry import Agent\nAGENT = Agent('stable_baselines3:A2C', observation='discrete')\n"
    task = "from tb2rl.tasks.wander import Wander\nclass Odyssey(Wander): pass\n"
    write_package(tmp_path, points, stranger_agent=agent, stranger_task=task)
    monkeypatch.syspath_prepend(tmp_path)
    assert {"stranger", "qlearn"} <= set(agent_names())
    assert {"odyssey", "maze"} <= set(task_names())
    assert find_agent("stranger") == Agent("stable_baselines3:A2C", observation="discrete")
    assert find_task("odyssey").__name__ == "Odyssey"
    with pytest.raises(InputError, match="did you mean 'stranger'"):
        find_agent("strange")


def test_a_built_in_agent_cannot_be_taken_over(tmp_path, monkeypatch):
    points = "[tb2rl.agents]\nqlearn = stranger_agent:AGENT\n[tb2rl.tasks]\nmaze = stranger_agent:AGENT\n"
    write_package(tmp_path, points)
    monkeypatch.syspath_prepend(tmp_path)
    assert (find_agent("qlearn").policy, find_task("maze").__name__) == ("QTable", "Wander")


def test_an_algorithm_by_module_and_class_trains(tmp_path):
    settings = {"total_timesteps": 32, "n_envs": 1, "eval_freq": 0}
    trained = train("stable_baselines3:A2C", settings={"agent.n_steps": 8}, folder=tmp_path / "run", **settings)
    assert (type(trained).__name__, trained.num_timesteps, trained.n_steps) == ("A2C", 32, 8)
    assert type(load(tmp_path / "run")) is type(trained)


def test_a_registry_entry_by_module_and_name_is_an_agent():
    assert find_agent("tb2rl.agents.qlearn:AGENT") == find_agent("qlearn")


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
def test_a_module_and_class_that_do_not_fit_are_refused(name, named):
    with pytest.raises(InputError, match=named):
        find_agent(name)
    with pytest.raises(InputError):
        find_task(name)


def test_an_error_inside_a_users_module_shows_as_it_is(tmp_path, monkeypatch):
    (tmp_path / "my_broken_agent.py").write_text("import a_package_that_is_missing\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="a_package_that_is_missing"):
        find_agent("my_broken_agent:Mine")
