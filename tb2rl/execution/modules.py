"""User-written modules, which travel to workers on other machines."""

from __future__ import annotations

import sys
import sysconfig
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import tb2rl
from tb2rl.execution.job import read_files, write_files

_INSTALLED = {"site-packages", "dist-packages"}  # of this environment, and of one below it
_DATA = (".urdf", ".yaml", ".yml", ".json", ".obj", ".stl", ".dae", ".txt")  # files that a module may read beside it

_folders: list[TemporaryDirectory[str]] = []  # removed with this process


class UserModules:
    """The source files of the imported modules that are neither installed nor part of tb2rl; unpickling installs them.

    Args:
        files: Content by path below an entry of `sys.path`; None: of the modules in this process.
    """

    def __init__(self, files: Mapping[str, bytes] | None = None) -> None:
        self.files = _user_files() if files is None else files

    def __setstate__(self, state: Mapping[str, Mapping[str, bytes]]) -> None:
        self.files = state["files"]
        if self.files:
            _folders.append(TemporaryDirectory(prefix="tb2rl-modules-"))
            write_files(self.files, Path(_folders[-1].name, "modules"))
            sys.path.insert(0, str(Path(_folders[-1].name, "modules")))


def _user_files() -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    for name, file in _user_modules():
        if file.name != "__init__.py":
            files[f"{name}{file.suffix}"] = file.read_bytes()
            files |= {each.name: each.read_bytes() for each in file.parent.glob("*") if each.suffix in _DATA}
        else:
            contents = read_files(file.parent).items()
            files |= {f"{name}/{path}": content for path, content in contents if _is_source(path)}
    return files


def _user_modules() -> Iterator[tuple[str, Path]]:
    """Name and file of each top-level module that a user wrote."""
    libraries = (sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib"), *tb2rl.__path__)
    folders = [Path(folder).resolve() for folder in libraries]
    for name, module in list(sys.modules.items()):
        path = getattr(module, "__file__", None)
        if not path or not path.endswith(".py") or "." in name or name in ("__main__", "__mp_main__"):
            continue
        file = Path(path).resolve()
        if not _INSTALLED & set(file.parts) and not any(file.is_relative_to(folder) for folder in folders):
            yield name, file


def _is_source(path: str) -> bool:
    return "__pycache__" not in path and not any(part.startswith(".") for part in path.split("/"))
