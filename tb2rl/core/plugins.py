"""Finds plugins by name, or by a reference "module:Name".

A name is built in, or an entry point of another package in the group `tb2rl.agents`, `tb2rl.simulators` and so on.
Built-in names have priority. Listing names imports no plugins.
"""

import inspect
import pkgutil
import sys
from collections.abc import Mapping
from dataclasses import MISSING, field, is_dataclass, make_dataclass
from functools import cache, partial
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Literal, TypeVar, get_type_hints

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import top_folder
from tb2rl.core.trust import check_module_allowed

Kind = Literal["agent", "filter", "robot", "simulator", "task", "world"]

T = TypeVar("T")
_VARIADIC = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)  # *args and **kwargs

FILTERS = {
    "passive_safety": "tb2rl.envs.passive_safety:PassiveSafety",
    "recovery": "tb2rl.envs.recovery:Recovery",
    "safety": "tb2rl.envs.safety:Safety",
    "speed_limits": "tb2rl.envs.filters:SpeedLimits",
}
ROBOTS = {name: f"tb2rl.robots.{name}:ROBOT" for name in ("jackal", "turtlebot2", "turtlebot3")}
SIMULATORS = {  # in the order of preference for evaluations
    "bullet": "tb2rl.simulation.bullet:SIMULATOR",
    "mujoco": "tb2rl.simulation.mujoco:SIMULATOR",
    "kinematic": "tb2rl.simulation.kinematic:SIMULATOR",
    "ros": "tb2rl.deploy.ros.robot:SIMULATOR",
}
HUMAN_VIEWER = "tb2rl.viz.viewer.environment:EnvViewer"  # of environments with `render_mode="human"`
TASKS = {
    "drive": "tb2rl.tasks.drive:Drive",
    "maze": "tb2rl.tasks.wander:Wander",
    "my-maze": "tb2rl.tasks.my_turtlebot2_maze:MyTurtleBot2Maze",
    "navigate": "tb2rl.tasks.navigate:Navigate",
    "wall": "tb2rl.tasks.reach_goal:ReachGoal",
}


def plugin_names(kind: Kind) -> list[str]:
    """Names of all plugins of a kind, first built-in ones, then entry points."""
    built_in = _built_in(kind)
    return [*built_in, *sorted(entry_point_references(kind).keys() - built_in.keys())]


agent_names = partial(plugin_names, "agent")
robot_names = partial(plugin_names, "robot")
simulator_names = partial(plugin_names, "simulator")
task_names = partial(plugin_names, "task")


def find_plugin(kind: Kind, name: str) -> Any:
    """Find a plugin by name, or by a reference "module:Name".

    Raises:
        InputError: If the plugin does not exist; the message lists the known names.
    """
    if ":" in name:
        check_module_allowed(name)  # outside `try`, so that its message does not begin with the kind
        try:
            return import_object(name)
        except InputError as error:
            raise InputError(f"{kind}: {error}") from None
    references = _built_in(kind)
    if name not in references:
        references = entry_point_references(kind) | references
    if name not in references:
        raise unknown(kind, name, references)
    return import_object(references[name])


def make_part(cls: type[T], arguments: Mapping[str, Any], where: str, extra: Mapping[str, Any] | None = None) -> T:
    """Make a sensor or a filter from arguments of a config, which are checked against the annotations of `cls`.

    `where` is the setting, for messages, and `extra` are arguments that a config cannot set.

    Raises:
        InputError: If an argument is unknown, missing or invalid.
    """
    from tb2rl.core.values import build  # here, because it imports pydantic, which listing names does not need

    extra, fields = extra or {}, []
    try:
        hints = get_type_hints(cls.__init__, include_extras=True) if arguments else {}
        for name, parameter in inspect.signature(cls).parameters.items():
            if name not in extra and parameter.kind not in _VARIADIC:
                is_required = parameter.default is parameter.empty
                # Only given arguments are passed on, so the default None is never used.
                fields.append((name, hints.get(name, Any), field(default=MISSING if is_required else None)))
        checked: Any = build(make_dataclass("Arguments", fields, kw_only=True), arguments, where)
        return cls(**extra, **{name: getattr(checked, name) for name in arguments})
    except InputError:
        raise
    except Exception as error:  # errors in a user's own class
        raise InputError(one_line(f"{where}: {type(error).__name__}: {error}")) from error


def entry_point_references(kind: Kind) -> dict[str, str]:
    """References of the entry points of one kind, by name."""
    return _entry_points(f"tb2rl.{kind}s", tuple(sys.path))


def import_object(reference: str) -> Any:
    """Import the object of a reference "module:Name".

    Raises:
        InputError: If the object does not exist, or `tb2rl.core.trust` forbids the import. Errors inside the module
            pass unchanged.
    """
    check_module_allowed(reference)
    module_name, _, attribute = reference.partition(":")
    if module_name == "__main__":
        return _find_in_main(attribute)
    parts = module_name.split(".")
    # A package's `__main__` is rejected, because its import would run a program.
    if parts[-1] == "py" or not all(part.isidentifier() and part != "__main__" for part in parts):
        raise InputError(f"cannot import {reference!r}: it should read module:Class, without .py or .__main__")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name and not (module_name + ".").startswith(error.name + "."):  # another module is missing
            raise
        hint = "; pip install sb3-contrib brings it" if error.name == "sb3_contrib" else ""
        raise InputError(f"cannot import {reference!r}: there is no module {error.name!r}{hint}") from None
    if not hasattr(module, attribute):
        raise InputError(f"cannot import {reference!r}: module {module_name!r} has no {attribute!r}")
    return getattr(module, attribute)


def reference_to(cls: type) -> str:
    """The reference "module:Class" of a class.

    Raises:
        InputError: If the reference now belongs to another class, because the class was defined again.
    """
    reference = f"{cls.__module__}:{cls.__qualname__}"
    if import_object(reference) is not cls:
        raise InputError(f"{reference} means another class by now; use that class, or define this class again")
    return reference


def _find_in_main(name: str) -> Any:
    """Find a class or a dataclass object (agent, robot, world) of the running script or notebook; no functions."""
    value = vars(sys.modules["__main__"]).get(name)
    if not is_dataclass(value) and not isinstance(value, type):
        hint = f"save {name} of the script or notebook in a file, and use the reference module:{name}"
        raise InputError(one_line(f"cannot import '__main__:{name}': the running script has no such class; {hint}"))
    return value


@cache  # for each `sys.path`, because a search takes 8 ms
def _entry_points(group: str, _path: tuple[str, ...]) -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=group)}


def _built_in(kind: Kind) -> dict[str, str]:
    if kind == "agent":
        # In a checkout, agents/ is beside the package; `tb2rl/__init__.py` makes it importable as `tb2rl.agents`.
        files = [module.name for module in pkgutil.iter_modules([str(top_folder("agents"))])]
        return {name: f"tb2rl.agents.{name}:AGENT" for name in files if not name.startswith("_")}
    return {"filter": FILTERS, "robot": ROBOTS, "simulator": SIMULATORS, "task": TASKS}.get(kind, {})  # world: none
