"""What a name means: agents, tasks, robots and worlds, built-in ones, those of other packages, and `module:Name`.

Nothing is imported before it is asked for, so that a list of names costs nothing: neither torch nor numba.
"""

from __future__ import annotations

import inspect
import os
import pkgutil
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import find_file, top_folder
from tb2rl.core.trust import check_module

if TYPE_CHECKING:
    from tb2rl.robots import Robot
    from tb2rl.tasks import Task
    from tb2rl.worlds import Import, World

ANY_POLICY = "MlpPolicy"  # or CnnPolicy, MlpLstmPolicy, ...: what the algorithm has for such observations


@dataclass(frozen=True)
class Agent:
    """A registry entry: what `train` and `evaluate` need to know to build an agent.

    Attributes:
        algorithm: A Stable-Baselines3 `BaseAlgorithm`, as "module:Class"; None for an agent that does not learn.
        policy: The algorithm's name for its policy, `ANY_POLICY` for the one that reads what is observed; for an
            agent that does not learn a `BasePolicy`, as "module:Class".
        observation: The observation mode it wants, "discrete" or "raw".
        only: Whether it can work with no other mode.
        actions: What it can learn, "named" (`Commands`) or "continuous" (`Velocities`); None: its algorithm says so.
    """

    algorithm: str | None
    policy: str = ANY_POLICY
    observation: str = "raw"
    only: bool = False
    actions: str | None = None


TASKS = {
    "drive": "tb2rl.tasks.drive:Drive",
    "maze": "tb2rl.tasks.wander:Wander",
    "navigate": "tb2rl.tasks.navigate:Navigate",
    "my-maze": "tb2rl.tasks.my_turtlebot2_maze:MyTurtleBot2Maze",
    "wall": "tb2rl.tasks.reach_goal:ReachGoal",
}
ROBOTS = {name: f"tb2rl.robots.{name}:ROBOT" for name in ("turtlebot2", "turtlebot3", "jackal")}
MADE_BY_CODE = re.compile(r"([A-Za-z_][\w.]*:[A-Za-z_]\w*)(?::(.+))?")  # module:WORLD, or module:reader:path


def agent_names() -> list[str]:
    """Every agent that has a name: the files of `agents/` and the entry points of `tb2rl.agents`."""
    return sorted({*_agent_files(), *_plugins("agents")})


def task_names() -> list[str]:
    """Every task that has a name: the built-in ones and the entry points of `tb2rl.tasks`."""
    return sorted({*TASKS, *_plugins("tasks")})


def robot_names() -> list[str]:
    """Every robot that has a name: the built-in ones and the entry points of `tb2rl.robots`."""
    return sorted({*ROBOTS, *_plugins("robots")})


def world_names() -> list[str]:
    """The built-in worlds."""
    return sorted(file.stem for file in _worlds_folder().glob("*.yaml"))


def find_agent(name: str) -> Agent:
    """The agent of a name, or of "module:Class", where Class is an algorithm or an `Agent`.

    Raises:
        InputError: If there is none; the message lists the known ones.
    """
    if name in _agent_files():
        return import_module(f"tb2rl.agents.{name}").AGENT
    found = _find(name, "agent", {}, agent_names)
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
    from tb2rl.tasks import Task

    found = name if isinstance(name, type) else _find(name, "task", TASKS, task_names)
    if not (isinstance(found, type) and issubclass(found, Task)) or inspect.isabstract(found):
        raise InputError(f"task {name!r} is not a class derived from tb2rl.tasks.Task with actions and judge")
    settings = [key for key, kind in found.__annotations__.items() if not _is_class_variable(kind)]
    if settings and "__dataclass_fields__" not in vars(found):
        raise InputError(f"task {name!r} has the settings {', '.join(settings)}, so it needs @dataclass(frozen=True)")
    return found


def find_robot(name: str) -> Robot:
    """The robot of a name, or of "module:ROBOT".

    Raises:
        InputError: If there is none (the message lists the known ones), or its numbers cannot be those of a robot.
    """
    from tb2rl.robots.robot import Robot, check_robot

    found = _imported("robot", name) if ":" in name else _find(name, "robot", ROBOTS, robot_names)
    if not isinstance(found, Robot):
        raise InputError(f"robot {name!r} is not a tb2rl.robots.Robot")
    check_robot(found)
    return found


def find_world(reference: str, said: Import | None = None) -> World:
    """The world of a built-in name, of a file's path, of "module:reader:path" or of "module:WORLD".

    A reader is a function from a path to a `World`; WORLD is a `World`, or a function without arguments that makes one.
    Functions say that they return a `World` by their annotation. Entry points of packages in the group `tb2rl.worlds`
    name readers by the ending of their files. `said` is said beside a file, such as a start.

    Raises:
        InputError: If there is none, or its file does not describe a world.
    """
    from tb2rl.worlds import World
    from tb2rl.worlds.readers import READERS, read_world

    code = MADE_BY_CODE.fullmatch(reference)
    if code is None:
        path = find_file(reference, _worlds_folder(), "world")
        found: Any = read_world(path, READERS.get(path.suffix) or _plugged_reader(reference, path.suffix), said)
    elif code[2] is None:
        found = _imported("world", code[1])
        found = found if isinstance(found, World) else _made(code[1])
    else:
        if not os.path.isfile(code[2]):  # noqa: PTH113 (Path.is_file raises for a name that is too long)
            raise InputError(one_line(f"there is no world file {code[2]}"))
        reader = world_maker(code[1])
        if not inspect.signature(reader).parameters:
            raise InputError(one_line(f"world {reference!r}: {code[1]} reads no file; write {code[1]}"))
        found = read_world(Path(code[2]), reader, said)
    if not isinstance(found, World):
        raise InputError(one_line(f"world {reference!r} is not a tb2rl.worlds.World but {type(found).__name__}"))
    return found


def world_maker(reference: str) -> Callable[..., World]:
    """The function of "module:function" that makes worlds.

    A world's name may come from a stranger's file, so nothing else may be called by it, such as `os.remove`.
    """
    from tb2rl.worlds import World

    found = _imported("world", reference)
    try:
        says = inspect.isfunction(found) and get_type_hints(found).get("return")
    except Exception:  # whatever stands in an annotation
        says = None
    if says is not World:
        name = reference.partition(":")[2]
        raise InputError(f"world {reference!r}: a function that makes worlds says so: def {name}(...) -> World")
    return found


def world_endings() -> list[str]:
    """How files of worlds can end: what a built-in reader or one of another package reads."""
    from tb2rl.worlds.readers import READERS

    return sorted({*READERS, *(f".{plugged}" for plugged in _plugins("worlds"))})


def _plugged_reader(reference: str, ending: str) -> Callable[[Path], World]:
    """What another package reads files with that end so."""
    plugins = {f".{plugged}": function for plugged, function in _plugins("worlds").items()}
    if ending not in plugins:
        raise unknown(f"ending of the world file {one_line(reference, 100)}:", ending, world_endings())
    return world_maker(plugins[ending])


def _made(reference: str) -> World:
    """The world that a function without arguments makes."""
    maker = world_maker(reference)
    if any(argument.default is argument.empty for argument in inspect.signature(maker).parameters.values()):
        raise InputError(f"world {reference!r} reads files; write {reference}:PATH")
    return maker()


def _is_class_variable(annotation: Any) -> bool:
    """Whether an annotation is a ClassVar; without `from __future__ import annotations` it is no text but the type."""
    return str(annotation).partition("[")[0].split(".")[-1] == "ClassVar"


def _worlds_folder() -> Path:
    return top_folder("configs") / "worlds"


def import_object(reference: str) -> Any:
    """What "module:Name" refers to.

    Raises:
        InputError: If there is no such module or name, or a stranger named it (`tb2rl.core.trust`); what goes wrong
            inside a module shows as it is.
    """
    check_module(reference)
    module_name, _, attribute = reference.partition(":")
    if module_name == "__main__":
        return _of_main(attribute)
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


def _of_main(name: str) -> Any:
    """What the script or the notebook that runs now calls so; looking runs nothing, and functions are not for it.

    Raises:
        InputError: If it has made no such class, nor such an agent, robot or world.
    """
    from tb2rl.robots import Robot
    from tb2rl.worlds import World

    found = vars(sys.modules["__main__"]).get(name)
    if not isinstance(found, type | Agent | Robot | World):
        where = f"it was made in another script or notebook; save __main__:{name} in a file, and name it module:{name}"
        raise InputError(one_line(f"cannot import '__main__:{name}': {where}"))
    return found


def reference_to(kind: type) -> str:
    """A class as "module:Class", by which a run finds it again.

    Raises:
        InputError: If that is not the class.
    """
    reference = f"{kind.__module__}:{kind.__qualname__}"
    if import_object(reference) is not kind:
        raise InputError(f"{reference} means another class by now; give that one, or define this one again")
    return reference


def _find(name: str, kind: str, ours: Mapping[str, str], names: Callable[[], list[str]]) -> Any:
    if ":" in name:
        _check_is_module(name)
        return import_object(name)
    references = ours if name in ours else _plugins(f"{kind}s")
    if name not in references:
        raise unknown(kind, name, names())
    return import_object(references[name])


def _imported(kind: str, reference: str) -> Any:
    """What "module:Name" refers to; the error says what of a task's settings it was to be."""
    try:
        _check_is_module(reference)
        return import_object(reference)
    except InputError as error:
        raise InputError(f"{kind}: {error}") from None


def _check_is_module(reference: str) -> None:
    module, _, attribute = reference.partition(":")
    if module.endswith(".py") and module[:-3].isidentifier():
        raise InputError(f"cannot import {reference!r}: a module has no .py; write {module[:-3]}:{attribute}")


def _agent_files() -> list[str]:
    names = [module.name for module in pkgutil.iter_modules([str(top_folder("agents"))])]
    return [name for name in names if not name.startswith("_")]


def _plugins(kind: str) -> dict[str, str]:
    """What other packages name; to go through all that are installed takes milliseconds."""
    return {point.name: point.value for point in entry_points(group=f"tb2rl.{kind}")}
