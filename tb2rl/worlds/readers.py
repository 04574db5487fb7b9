"""Which reader opens a world's file, by the ending of its name; a new built-in format is a line in `READERS`."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import cast

from tb2rl.core.errors import InputError
from tb2rl.core.files import parse_yaml, read_text
from tb2rl.worlds.description import world_from
from tb2rl.worlds.formats.imports import Import
from tb2rl.worlds.formats.maps import is_map, read_map
from tb2rl.worlds.formats.sdf import read_sdf
from tb2rl.worlds.world import World

_LARGEST_YAML, _LARGEST_MAP = 2**20, 2**15  # [bytes] YAML is read slowly; a world of 5 000 boxes has 0.5 MB
_IMAGE = re.compile(r"^image[ \t]*:(.*)", re.MULTILINE)  # the picture of a map

Reader = Callable[[Path], World]
BuiltIn = Callable[[Path, Import], World]


def _read_yaml(path: Path, said: Import) -> World:
    """The world of a YAML file: one of ours, or a map of ROS; their keys tell them apart."""
    text = _read_limited(path)
    if _IMAGE.search(text):
        _check_size(path, _LARGEST_MAP)
    content = parse_yaml(text, str(path))
    content = {} if content is None else content
    if is_map(content):
        return read_map(path, content, said)
    return world_from(content, path.stem, said)


def _read_drawn(path: Path, said: Import) -> World:
    return world_from({"drawing": _read_limited(path)}, path.stem, said)


def _read_limited(path: Path) -> str:
    _check_size(path, _LARGEST_YAML)
    return read_text(path)


def _check_size(path: Path, largest: int) -> None:
    if (size := path.stat().st_size) > largest:
        raise InputError(f"{path} is too large: {size >> 10} kB, the limit is {largest >> 10}")


READERS: dict[str, BuiltIn] = {
    ".sdf": read_sdf,
    ".txt": _read_drawn,
    ".world": read_sdf,
    ".yaml": _read_yaml,
    ".yml": _read_yaml,
}


def read_world(path: Path, reader: Reader | BuiltIn | None = None, said: Import | None = None) -> World:
    """The world of a file; read once, and again when the file or a map's picture has changed.

    Args:
        path: The file.
        reader: What reads it; None: the built-in reader for its ending.
        said: What is said beside the file, such as its start.

    Raises:
        InputError: If it does not describe a world.
    """
    changed = tuple(file.stat().st_mtime_ns for file in files_of(path))
    return _read(path.resolve(), changed, reader or READERS[path.suffix], said or Import())


def files_of(path: Path) -> list[Path]:
    """The files that a world's file stands for: itself, and the picture of a map."""
    files = [path]
    if path.suffix in (".yaml", ".yml") and path.stat().st_size <= _LARGEST_MAP:
        image = _IMAGE.search(path.read_text(encoding="utf-8", errors="replace"))
        picture = path.parent / image[1].strip(" \t\r'\"") if image else path
        files += [picture] if os.path.isfile(picture) else []  # noqa: PTH113 (Path.is_file raises for a name that is too long)
    return files


@lru_cache(maxsize=32)
def _read(path: Path, _modified: tuple[int, ...], reader: Reader | BuiltIn, said: Import) -> World:
    if reader in READERS.values():
        return cast(BuiltIn, reader)(path, said)
    world = cast(Reader, reader)(path)  # of another's code: whether it is a world, the registry asks
    return world.with_places(said.start, said.goal, said.bounds) if isinstance(world, World) else world
