"""Limits on what the config of a policy may import, because configs name modules and can come from anybody.

`block_imports` of a run folder: it holds data, so no code in it runs, even where Python was started in it.
`untrusted_source`: configs that somebody shared name only modules that everybody has. `tb2rl.core.plugins` enforces it.
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

PACKAGES = ("tb2rl", "stable_baselines3", "sb3_contrib", "torch")  # their modules may be named by any config
_source: ContextVar[str | None] = ContextVar("_source", default=None)


@contextmanager
def untrusted_source(source: str) -> Iterator[None]:
    """Let configs name no files, and no modules but those of `PACKAGES` and of installed plugins.

    Args:
        source: Origin of the configs, for the message: "hf:user/repository". An enclosing block's source wins.
    """
    before = _source.set(_source.get() or source)
    try:
        yield
    finally:
        _source.reset(before)


def check_module(reference: str) -> None:
    """Raise an `InputError` if an untrusted config may not name this "module:Name"."""
    module = reference.partition(":")[0]
    if _source.get() is not None and not _is_known(module):
        _refuse(f"the module {one_line(repr(module), 100)}, which is not of {', '.join(PACKAGES)}")


def check_file(path: str) -> None:
    """Raise an `InputError` if an untrusted config may not name a file or a folder of this machine."""
    if _source.get() is not None:
        _refuse(f"the file {one_line(repr(path), 100)} of this machine")


def _refuse(what: str) -> None:
    raise InputError(f"{_source.get()} names {what}; if you trust it, say so with trust=True, or --trust")


def _is_known(module: str) -> bool:
    package, _, inner = module.partition(".")
    if package == "tb2rl":  # in a checkout its path includes the folder around it, with any other files there
        rooms = {each.name for each in pkgutil.iter_modules([str(Path(__file__).parent.parent)])}
        return inner.partition(".")[0] in {*rooms, "agents"}
    return package in PACKAGES or package in _plugin_packages()


def _plugin_packages() -> set[str]:
    """Packages with entry points; whoever installed them trusts them."""
    points = [
        point for kind in ("agents", "robots", "tasks", "worlds") for point in entry_points(group=f"tb2rl.{kind}")
    ]
    return {point.module.partition(".")[0] for point in points}


@contextmanager
def block_imports(folder: Path) -> Iterator[None]:
    """Refuse to import a module that lies in a folder, even where `sys.path` leads into it."""
    finder = _FolderBlocker(folder)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


class _FolderBlocker(MetaPathFinder):
    """Finds nothing; raises an `InputError` where the usual finder would find a file in the folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        found = PathFinder.find_spec(name, path, target)
        if found and found.origin and Path(found.origin).resolve().is_relative_to(self._folder):
            raise InputError(f"the module {name!r} lies in {self._folder}, and nothing is imported from a run folder")
        return None
