"""Restricts imports and file access of untrusted configs, because configs refer to modules and files."""

import pkgutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from tb2rl.core.errors import InputError, one_line

PACKAGES = ("tb2rl", "stable_baselines3", "sb3_contrib", "torch")  # packages that untrusted configs may import
_source: ContextVar[str | None] = ContextVar("_source", default=None)  # origin of the untrusted config; None: trusted


@contextmanager
def untrusted_source(source: str) -> Iterator[None]:
    """During the block, configs may refer to no files, and only to modules of `PACKAGES` and of installed plugins.

    `source` is the origin of the config for messages, such as "hf:user/repository". In nested blocks, the outermost
    source is used.
    """
    token = _source.set(_source.get() or source)
    try:
        yield
    finally:
        _source.reset(token)


def check_module_allowed(reference: str) -> None:
    """Raise an `InputError` if the present config is untrusted and may not import the module of a reference."""
    module = reference.partition(":")[0]
    if _source.get() is not None and not _is_allowed(module):
        _reject(f"the module {one_line(repr(module), 100)}, which is not in {', '.join(PACKAGES)}")


def check_file_allowed(path: str) -> None:
    """Raise an `InputError` if the present config is untrusted, because such a config may refer to no files."""
    if _source.get() is not None:
        _reject(f"the file {one_line(repr(path), 100)} of this machine")


def _reject(item: str) -> None:
    raise InputError(f"{_source.get()} names {item}; if you trust it, say so with trust=True, or --trust")


def _is_allowed(module: str) -> bool:
    package, _, submodule = module.partition(".")
    if package == "tb2rl":  # only its own modules, because in a checkout it also imports files beside the package
        own_modules = {info.name for info in pkgutil.iter_modules([str(Path(__file__).parent.parent)])}
        return submodule.partition(".")[0] in {*own_modules, "agents"}
    # Installed packages with entry points in these groups are trusted.
    groups = [f"tb2rl.{kind}" for kind in ("agents", "filters", "robots", "simulators", "tasks", "worlds")]
    plugins = {point.module.partition(".")[0] for group in groups for point in entry_points(group=group)}
    return package in {*PACKAGES, *plugins}


@contextmanager
def block_imports(folder: Path) -> Iterator[None]:
    """Raise an `InputError` for imports from a folder with data, even if the folder is on `sys.path`."""
    finder = _FolderBlocker(folder.resolve())
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


@dataclass(frozen=True)
class _FolderBlocker(MetaPathFinder):
    """An import finder that finds no modules, but raises an `InputError` if a module lies in the folder."""

    folder: Path

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target)
        if spec and spec.origin and Path(spec.origin).resolve().is_relative_to(self.folder):
            raise InputError(f"the module {name!r} lies in {self.folder}, and nothing is imported from a run folder")
        return None
