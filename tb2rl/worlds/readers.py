"""Which reader opens a world's file, by the ending of its name; a new built-in format is a line in `READERS`."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import cast

from tb2rl.files import parse_yaml, read_text
from tb2rl.worlds.description import world_from
from tb2rl.worlds.formats.imports import Import
from tb2rl.worlds.formats.maps import is_map, read_map
from tb2rl.worlds.formats.sdf import read_sdf
from tb2rl.worlds.world import World

Reader = Callable[[Path], World]
BuiltIn = Callable[[Path, Import], World]


def _read_yaml(path: Path, said: Import) -> World:
    """The world of a YAML file: one of ours, or a map of ROS; their keys tell them apart."""
    content = parse_yaml(read_text(path), str(path))
    content = {} if content is None else content
    if is_map(content):
        return read_map(path, content, said)
    return world_from(content, path.stem, said)


def _read_drawn(path: Path, said: Import) -> World:
    return world_from({"drawing": read_text(path)}, path.stem, said)


READERS: dict[str, BuiltIn] = {
    ".sdf": read_sdf,
    ".txt": _read_drawn,
    ".world": read_sdf,
    ".yaml": _read_yaml,
    ".yml": _read_yaml,
}


def read_world(path: Path, reader: Reader | BuiltIn | None = None, said: Import | None = None) -> World:
    """The world of a file; read once, and again when the file has changed.

    Args:
        path: The file.
        reader: What reads it; None: the built-in reader for its ending.
        said: What is said beside the file, such as its start.

    Raises:
        InputError: If it does not describe a world.
    """
    return _read(path.resolve(), path.stat().st_mtime_ns, reader or READERS[path.suffix], said or Import())


@lru_cache(maxsize=32)
def _read(path: Path, _modified: int, reader: Reader | BuiltIn, said: Import) -> World:
    if reader in READERS.values():
        return cast(BuiltIn, reader)(path, said)
    return cast(Reader, reader)(path).with_places(said.start, said.goal, said.bounds)
