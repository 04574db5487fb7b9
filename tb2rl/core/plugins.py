"""Plugins by name: built-in objects, those of other packages, and references such as "module:Name".

A name is a built-in one or an entry point of the group `tb2rl.agents`, `tb2rl.simulators` and so on.
Built-in names win. Listing names imports nothing.
"""

from __future__ import annotations

import inspect
import pkgutil
import sys
from collections.abc import Mapping
from dataclasses import is_dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Literal, TypeVar, get_type_hints

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import top_folder
from tb2rl.core.trust import check_module

Kind = Literal["agent", "filter", "robot", "simulator", "task", "world"]

T = TypeVar("T")
_ANY_NUMBER = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)

FILTERS = {"speed_limits": "tb2rl.envs.filters:SpeedLimits"}
ROBOTS = {name: f"tb2rl.robots.{name}:ROBOT" for name in ("turtlebot2", "turtlebot3", "jackal")}
SIMULATORS = {  # in the order of preference for evaluations
    "bullet": "tb2rl.simulation.bullet:SIMULATOR",
    "kinematic": "tb2rl.simulation.kinematic:SIMULATOR",
    "ros": "tb2rl.deploy.ros.robot:SIMULATOR",
}
TASKS = {
    "drive": "tb2rl.tasks.drive:Drive",
    "maze": "tb2rl.tasks.wander:Wander",
    "navigate": "tb2rl.tasks.navigate:Navigate",
    "my-maze": "tb2rl.tasks.my_turtlebot2_maze:MyTurtleBot2Maze",
    "wall": "tb2rl.tasks.reach_goal:ReachGoal",
}


def agent_names() -> list[str]:
    """Names of all agents: the files of `agents/` and entry points."""
    return sorted(_references("agent"))


def robot_names() -> list[str]:
    """Names of all robots, built-in ones and entry points."""
    return sorted(_references("robot"))


def simulator_names() -> list[str]:
    """Names of all simulators, in the order of preference: built-in ones, then entry points."""
    return [*SIMULATORS, *sorted(entry_point_references("simulator").keys() - SIMULATORS.keys())]


def task_names() -> list[str]:
    """Names of all tasks, built-in ones and entry points."""
    return sorted(_references("task"))


def find_plugin(kind: Kind, name: str) -> Any:
    """The object of a name or of a reference "module:Name".

    Raises:
        InputError: If there is none; the message lists the known names.
    """
    if ":" in name:
        check_module(name)  # its message begins with the untrusted source, not with the kind
        try:
            return import_object(name)
        except InputError as error:
            raise InputError(f"{kind}: {error}") from None
    references = _references(kind)
    if name not in references:
        raise unknown(kind, name, references)
    return import_object(references[name])


def make_part(cls: type[T], arguments: Mapping[str, Any], where: str, given: Mapping[str, Any] | None = None) -> T:
    """Make a sensor or a filter from the arguments of a config.

    Args:
        cls: Its class.
        arguments: Checked against the annotations of `cls`.
        where: The setting, for messages.
        given: Further arguments, which a config cannot set.

    Raises:
        InputError: If an argument is unknown, missing or does not fit.
    """
    from tb2rl.core.values import checked  # imports pydantic, which listing names must not

    given, taken = given or {}, inspect.signature(cls).parameters
    for key in arguments:
        if key not in taken or key in given:
            raise unknown(f"argument of {where}:", key, taken.keys() - given.keys())
    needed = [key for key, one in taken.items() if one.default is one.empty and one.kind not in _ANY_NUMBER]
    missing = [key for key in needed if key not in {*given, *arguments}]
    if missing:
        raise InputError(f"{where}: it needs {', '.join(missing)}; give the arguments as {{{missing[0]}: ...}}")
    try:
        hints = get_type_hints(cls.__init__, include_extras=True) if arguments else {}
        fitting = {key: checked(hints.get(key, Any), value, f"{where}.{key}") for key, value in arguments.items()}
        return cls(**given, **fitting)
    except InputError:
        raise
    except Exception as error:  # of a user's own class
        raise InputError(one_line(f"{where}: {type(error).__name__}: {error}")) from error


def entry_point_references(kind: Kind) -> dict[str, str]:
    """References of the entry points of one kind, by name."""
    return {point.name: point.value for point in entry_points(group=f"tb2rl.{kind}s")}


def import_object(reference: str) -> Any:
    """The object of a reference "module:Name".

    Raises:
        InputError: If the module or the name does not exist, or an untrusted config names it (`tb2rl.core.trust`).
            Errors inside the module pass unchanged.
    """
    check_module(reference)
    module_name, _, attribute = reference.partition(":")
    if module_name == "__main__":
        return _from_main(attribute)
    if module_name.endswith(".py") and module_name[:-3].isidentifier():
        hint = f"a module has no .py; write {module_name[:-3]}:{attribute}"
        raise InputError(f"cannot import {reference!r}: {hint}")
    if not all(part.isidentifier() and part != "__main__" for part in module_name.split(".")):
        raise InputError(f"cannot import {reference!r}: it should read module:Class")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name and not (module_name + ".").startswith(error.name + "."):
            raise
        hint = "; pip install sb3-contrib brings it" if error.name == "sb3_contrib" else ""
        raise InputError(f"cannot import {reference!r}: there is no module {error.name!r}{hint}") from None
    if not hasattr(module, attribute):
        raise InputError(f"cannot import {reference!r}: module {module_name!r} has no {attribute!r}")
    return getattr(module, attribute)


def reference_to(cls: type) -> str:
    """The reference "module:Class" of a class, by which a run finds it again.

    Raises:
        InputError: If the reference means another class.
    """
    reference = f"{cls.__module__}:{cls.__qualname__}"
    if import_object(reference) is not cls:
        raise InputError(f"{reference} means another class by now; give that one, or define this one again")
    return reference


def _from_main(name: str) -> Any:
    """A class or a dataclass (agent, robot, world) of the running script or notebook; functions are refused."""
    found = vars(sys.modules["__main__"]).get(name)
    if not is_dataclass(found) and not isinstance(found, type):
        where = f"it was made in another script or notebook; save __main__:{name} in a file, and name it module:{name}"
        raise InputError(one_line(f"cannot import '__main__:{name}': {where}"))
    return found


def _references(kind: Kind) -> Mapping[str, str]:
    built_in = {"agent": _agent_files(), "filter": FILTERS, "robot": ROBOTS, "simulator": SIMULATORS, "task": TASKS}
    return {**entry_point_references(kind), **built_in[kind]}


def _agent_files() -> dict[str, str]:
    files = [module.name for module in pkgutil.iter_modules([str(top_folder("agents"))])]
    return {name: f"tb2rl.agents.{name}:AGENT" for name in files if not name.startswith("_")}
