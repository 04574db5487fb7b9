"""Tasks by name."""

from __future__ import annotations

import inspect

from tb2rl.core.errors import InputError
from tb2rl.core.plugins import find_plugin
from tb2rl.tasks.task import Task


def find_task(name: str | type[Task]) -> type[Task]:
    """The task class of a name, or of "module:Class"; a class is returned unchanged.

    Raises:
        InputError: If there is none, or its settings are not fields of a dataclass.
    """
    found = name if isinstance(name, type) else find_plugin("task", name)
    if not (isinstance(found, type) and issubclass(found, Task)) or inspect.isabstract(found):
        raise InputError(f"task {name!r} is not a class derived from tb2rl.tasks.Task with actions and outcome")
    settings = [key for key, annotation in found.__annotations__.items() if "ClassVar" not in str(annotation)]
    if settings and "__dataclass_fields__" not in vars(found):
        raise InputError(f"task {name!r} has the settings {', '.join(settings)}, so it needs @dataclass(frozen=True)")
    return found
