"""Agents and tasks by name: built-in ones, those of other packages, and `module:Class` without either.

Nothing is imported before it is asked for, so that a list of names costs no torch.
"""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from tb2rl.errors import InputError, unknown
from tb2rl.settings import room
from tb2rl.tasks import Task


@dataclass(frozen=True)
class Agent:
    """A registry entry: what `train` and `evaluate` need to know to build an agent.

    Attributes:
        algorithm: A Stable-Baselines3 `BaseAlgorithm`, as "module:Class"; None for an agent that does not learn.
        policy: The algorithm's name for its policy; for an agent that does not learn a `BasePolicy`, as "module:Class".
        observation: The observation mode it wants, "discrete" or "raw".
        only: Whether it can work with no other mode.
    """

    algorithm: str | None
    policy: str = "MlpPolicy"
    observation: str = "raw"
    only: bool = False


TASKS = {
    "maze": "tb2rl.tasks.wander:Wander",
    "my-maze": "tb2rl.tasks.my_turtlebot2_maze:MyTurtleBot2Maze",
    "wall": "tb2rl.tasks.reach_goal:ReachGoal",
}


def agent_names() -> list[str]:
    """Every agent that has a name: the files of `agents/` and the entry points of `tb2rl.agents`."""
    return sorted({*_agent_files(), *_plugins("agents")})


def task_names() -> list[str]:
    """Every task that has a name: the built-in ones and the entry points of `tb2rl.tasks`."""
    return sorted({*TASKS, *_plugins("tasks")})


def find_agent(name: str) -> Agent:
    """The agent of a name, or of "module:Class", where Class is an algorithm or an `Agent`.

    Raises:
        InputError: If there is none; the message lists the known ones.
    """
    if name in _agent_files():
        return import_module(f"tb2rl.agents.{name}").AGENT
    found = _find(name, "agent", _plugins("agents"), agent_names)
    if isinstance(found, Agent):
        return found
    from stable_baselines3.common.base_class import BaseAlgorithm

    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        raise InputError(f"agent {name!r} is neither a Stable-Baselines3 algorithm nor a tb2rl.registry.Agent")
    return Agent(algorithm=f"{found.__module__}:{found.__name__}")


def find_task(name: str | type[Task]) -> type[Task]:
    """The task class of a name, or of "module:Class", or the class itself.

    Raises:
        InputError: If there is none; the message lists the known ones.
    """
    found = name if isinstance(name, type) else _find(name, "task", {**_plugins("tasks"), **TASKS}, task_names)
    if not (isinstance(found, type) and issubclass(found, Task)) or inspect.isabstract(found):
        raise InputError(f"task {name!r} is not a class derived from tb2rl.tasks.Task with commands and judge")
    settings = [key for key, kind in found.__annotations__.items() if not str(kind).startswith("ClassVar")]
    if settings and "__dataclass_fields__" not in vars(found):
        raise InputError(f"task {name!r} has the settings {', '.join(settings)}, so it needs @dataclass(frozen=True)")
    return found


def import_object(reference: str) -> Any:
    """What "module:Name" refers to.

    Raises:
        InputError: If there is no such module or name; what goes wrong inside a module shows as it is.
    """
    module_name, _, attribute = reference.partition(":")
    if not all(part.isidentifier() and part != "__main__" for part in module_name.split(".")):
        raise InputError(f"cannot import {reference!r}: it should read module:Class")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name and not (module_name + ".").startswith(error.name + "."):
            raise
        raise InputError(f"cannot import {reference!r}: there is no module {error.name!r}") from None
    if not hasattr(module, attribute):
        raise InputError(f"cannot import {reference!r}: module {module_name!r} has no {attribute!r}")
    return getattr(module, attribute)


def _find(name: str, kind: str, references: dict[str, str], names: Callable[[], list[str]]) -> Any:
    if ":" in name:
        return import_object(name)
    if name not in references:
        raise unknown(kind, name, names())
    return import_object(references[name])


def _agent_files() -> list[str]:
    return [module.name for module in pkgutil.iter_modules([str(room("agents"))]) if not module.name.startswith("_")]


def _plugins(kind: str) -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=f"tb2rl.{kind}")}
