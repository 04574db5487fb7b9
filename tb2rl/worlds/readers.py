"""Which reader opens a world's file, by the ending of its name; a new built-in format is a line in `READERS`."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from tb2rl.files import read_text
from tb2rl.worlds.description import read_description, world_from
from tb2rl.worlds.world import World

Reader = Callable[[Path], World]


def _read_drawn(path: Path) -> World:
    return world_from({"drawing": read_text(path)}, path.stem)


READERS: dict[str, Reader] = {".yaml": read_description, ".yml": read_description, ".txt": _read_drawn}


def read_world(path: Path, reader: Reader | None = None) -> World:
    """The world of a file; read once, and again when the file has changed.

    Args:
        path: The file.
        reader: What reads it; None: the built-in reader for its ending.

    Raises:
        InputError: If it does not describe a world.
    """
    return _read(path.resolve(), path.stat().st_mtime_ns, reader or READERS[path.suffix])


@lru_cache(maxsize=32)
def _read(path: Path, _modified: int, reader: Reader) -> World:
    return reader(path)
