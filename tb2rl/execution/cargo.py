"""What jobs need on another machine beside tb2rl: the user's own modules, and what all jobs share."""

from __future__ import annotations

import pickle
import sys
import sysconfig
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import cloudpickle

import tb2rl
from tb2rl.execution.job import files_in, write_files

_INSTALLED = {"site-packages", "dist-packages"}  # of this environment, and of one that it is laid over
_DATA = (".urdf", ".yaml", ".yml", ".json", ".obj", ".stl", ".dae", ".txt")  # beside a module, what it may read

_folders: list[TemporaryDirectory[str]] = []  # that end with this process


def packed(shared: Any) -> bytes:
    """The modules that were imported here and are not installed, and what all jobs share."""
    return pickle.dumps((_users_files(), cloudpickle.dumps(shared)))


@lru_cache(maxsize=1)
def unpacked(cargo: bytes) -> Any:
    """What all jobs share; from now on this process imports the modules that came with it."""
    files, shared = pickle.loads(cargo)
    if files:
        _folders.append(TemporaryDirectory(prefix="tb2rl-modules-"))
        write_files(files, Path(_folders[-1].name, "modules"))
        sys.path.insert(0, str(Path(_folders[-1].name, "modules")))
    return pickle.loads(shared)


def _users_files() -> dict[str, bytes]:
    """The files of the modules that a user wrote, by their path below an entry of `sys.path`."""
    files: dict[str, bytes] = {}
    for name, file in _users_modules():
        if file.name != "__init__.py":
            files[f"{name}{file.suffix}"] = file.read_bytes()
            files |= {each.name: each.read_bytes() for each in file.parent.glob("*") if each.suffix in _DATA}
        else:
            files |= {f"{name}/{path}": content for path, content in files_in(file.parent).items() if _is_kept(path)}
    return files


def _users_modules() -> Iterator[tuple[str, Path]]:
    """The modules without a dot in their names that are neither installed nor of tb2rl, and their files."""
    others = (sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib"), *tb2rl.__path__)
    folders = [Path(folder).resolve() for folder in others]
    for name, module in list(sys.modules.items()):
        file = _file_of(module)
        if file is None or "." in name or name in ("__main__", "__mp_main__") or _INSTALLED & set(file.parts):
            continue
        if not any(file.is_relative_to(folder) for folder in folders):
            yield name, file


def _file_of(module: ModuleType) -> Path | None:
    file = getattr(module, "__file__", None)
    return Path(file).resolve() if file and file.endswith(".py") else None


def _is_kept(path: str) -> bool:
    return "__pycache__" not in path and not any(part.startswith(".") for part in path.split("/"))
