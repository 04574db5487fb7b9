"""The filters of the commands that a task's setting `filters` lists."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.plugins import find_plugin, make_part
from tb2rl.envs import filters
from tb2rl.envs.filters import Filter
from tb2rl.tasks import Task


def task_filters(task: Task) -> tuple[Filter, ...]:
    """New filters, in the order of `task.filters`.

    Raises:
        InputError: If there is no such filter, or an argument does not fit.
    """
    return tuple(make_part(cls, arguments, f"task.filters.{cls.__name__}") for cls, arguments in _classes(task))


def describe_filters(task: Task) -> tuple[list[dict[str, Any]], list[Path]]:
    """The filters of a task for an exported policy.

    Returns:
        Class name and arguments of each, and the files that define classes of the user's own.
    """
    entries = [{"class": cls.__name__, "arguments": dict(arguments)} for cls, arguments in _classes(task)]
    files = [Path(inspect.getfile(cls)) for cls, _ in _classes(task)]
    return entries, [file for file in dict.fromkeys(files) if file != Path(filters.__file__)]


def _classes(task: Task) -> Iterator[tuple[type[Filter], Mapping[str, Any]]]:
    for entry in task.filters:
        ((name, arguments),) = [(entry, None)] if isinstance(entry, str) else entry.items()
        cls = find_plugin("filter", name)
        if not (isinstance(cls, type) and issubclass(cls, Filter)):
            raise InputError(one_line(f"task.filters: {name!r} is not a class derived from tb2rl.envs.filters.Filter"))
        yield cls, arguments or {}
