"""Readers of world files, by the ending of their names; a new built-in format is a line in `READERS`."""

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
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.formats.maps import is_map, read_map
from tb2rl.worlds.formats.sdf import read_sdf
from tb2rl.worlds.world import World

_LARGEST_YAML, _LARGEST_MAP = 2**20, 2**15  # [bytes] YAML is read slowly; a world of 5 000 boxes has 0.5 MB
_IMAGE = re.compile(r"^image[ \t]*:(.*)", re.MULTILINE)  # the image of a map

Reader = Callable[[Path], World]
BuiltInReader = Callable[[Path, ImportOptions], World]


def _read_yaml(path: Path, options: ImportOptions) -> World:
    """Read a YAML file: a world of ours or a ROS map, which their keys tell apart."""
    text = _read_limited(path)
    if _IMAGE.search(text):
        _check_size(path, _LARGEST_MAP)
    content = parse_yaml(text, str(path))
    content = {} if content is None else content
    if is_map(content):
        return read_map(path, content, options)
    return world_from(content, path.stem, options)


def _read_drawing(path: Path, options: ImportOptions) -> World:
    return world_from({"drawing": _read_limited(path)}, path.stem, options)


def _read_limited(path: Path) -> str:
    _check_size(path, _LARGEST_YAML)
    return read_text(path)


def _check_size(path: Path, largest: int) -> None:
    if (size := path.stat().st_size) > largest:
        raise InputError(f"{path} is too large: {size >> 10} kB, the limit is {largest >> 10}")


READERS: dict[str, BuiltInReader] = {
    ".sdf": read_sdf,
    ".txt": _read_drawing,
    ".world": read_sdf,
    ".yaml": _read_yaml,
    ".yml": _read_yaml,
}


def read_world(path: Path, reader: Reader | BuiltInReader | None = None, options: ImportOptions | None = None) -> World:
    """Read the world of a file; cached until the file or a map's image changes.

    Args:
        path: The file.
        reader: A user's reader; None: the built-in reader for its ending.
        options: Settings beside the file, such as its start.

    Raises:
        InputError: If it does not describe a world.
    """
    changed = tuple(file.stat().st_mtime_ns for file in source_files(path))
    return _read(path.resolve(), changed, reader or READERS[path.suffix], options or ImportOptions())


def source_files(path: Path) -> list[Path]:
    """The files that a world is read from: its file, and the image of a map."""
    files = [path]
    if path.suffix in (".yaml", ".yml") and path.stat().st_size <= _LARGEST_MAP:
        image = _IMAGE.search(path.read_text(encoding="utf-8", errors="replace"))
        picture = path.parent / image[1].strip(" \t\r'\"") if image else path
        files += [picture] if os.path.isfile(picture) else []  # noqa: PTH113 (Path.is_file raises for a name that is too long)
    return files


@lru_cache(maxsize=32)
def _read(path: Path, _modified: tuple[int, ...], reader: Reader | BuiltInReader, options: ImportOptions) -> World:
    if reader in READERS.values():
        return cast(BuiltInReader, reader)(path, options)
    world = cast(Reader, reader)(path)  # a user's code; the registry checks that it is a world
    return world.with_places(options.start, options.goal, options.bounds) if isinstance(world, World) else world
