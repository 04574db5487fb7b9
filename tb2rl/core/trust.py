"""What the config of a policy may have imported: it names modules, and it comes from anybody.

Two limits hold while a config is read. `nothing_from` a folder: a run folder holds data, so no code in it runs, also
where Python was started in it. And `distrusting` whoever shared a policy: their configs name what everybody has.
`import_object` of the registry asks here, whatever part of a config a name is in.
"""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from tb2rl.core.errors import InputError, one_line

PACKAGES = ("tb2rl", "stable_baselines3", "sb3_contrib", "torch")  # whose modules anybody's config may name
_PLUGS = ("agents", "robots", "tasks", "worlds")  # groups of entry points
_stranger: ContextVar[str | None] = ContextVar("_stranger", default=None)


@contextmanager
def distrusting(stranger: str) -> Iterator[None]:
    """Let configs name no modules but those of `PACKAGES` and of installed plugins, and no files.

    Args:
        stranger: Whose configs they are, for the message: "hf:user/repository"; within another such block that one's.
    """
    before = _stranger.set(_stranger.get() or stranger)
    try:
        yield
    finally:
        _stranger.reset(before)


def check_module(reference: str) -> None:
    """Raise an `InputError` if a stranger's config may not name this, "module:Name"."""
    module = reference.partition(":")[0]
    if _stranger.get() is not None and not _is_known(module):
        _refuse(f"the module {one_line(repr(module), 100)}, which is not of {', '.join(PACKAGES)}")


def check_file(path: str) -> None:
    """Raise an `InputError` if a stranger's config may not name a file or a folder on this machine."""
    if _stranger.get() is not None:
        _refuse(f"the file {one_line(repr(path), 100)} of this machine")


def _refuse(what: str) -> None:
    raise InputError(f"{_stranger.get()} names {what}; if you trust it, say so with trust=True, or --trust")


def _is_known(module: str) -> bool:
    package, _, inner = module.partition(".")
    if package == "tb2rl":  # whose path in a checkout has the folder around it, too, with whatever lies there
        rooms = {each.name for each in pkgutil.iter_modules([str(Path(__file__).parent.parent)])}
        return inner.partition(".")[0] in {*rooms, "agents"}
    return package in PACKAGES or package in _plugged()


def _plugged() -> set[str]:
    """The packages that bring agents, tasks, robots or worlds by entry points: whoever installed them trusts them."""
    points = [point for kind in _PLUGS for point in entry_points(group=f"tb2rl.{kind}")]
    return {point.module.partition(".")[0] for point in points}


@contextmanager
def nothing_from(folder: Path) -> Iterator[None]:
    """Refuse to import a module that lies in a folder, also where `sys.path` leads into it."""
    finder = _Outside(folder)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


class _Outside(MetaPathFinder):
    """Finds nothing, and raises an `InputError` where the usual finder would find a file in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        found = PathFinder.find_spec(name, path, target)
        if found and found.origin and Path(found.origin).resolve().is_relative_to(self._folder):
            raise InputError(f"the module {name!r} lies in {self._folder}, and nothing is imported from a run folder")
        return None
