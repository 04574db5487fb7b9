"""Finds worlds by name, file, or reference to code; `READERS` lists the built-in file formats."""

import inspect
import os
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, get_type_hints

from tb2rl.core import InputError, find_plugin, one_line, unknown
from tb2rl.core.files import find_file, read_text, read_yaml, top_folder
from tb2rl.core.plugins import entry_point_references
from tb2rl.worlds.description import parse_world
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.formats.maps import read_map
from tb2rl.worlds.formats.sdf import read_sdf
from tb2rl.worlds.world import World

WORLD_OR_READER = re.compile(r"([A-Za-z_][\w.]*:[A-Za-z_]\w*)(?::(?P<path>.+))?")  # module:WORLD, or module:reader:path
_BUILT_IN = top_folder("configs") / "worlds"  # folder of the built-in worlds
_MAX_FILE_SIZE = 2**20  # [bytes] for text files, because YAML is slow; a world of 5 000 boxes has 0.5 MB
_IMAGE = re.compile(r"^image[ \t]*:(.*)", re.MULTILINE)  # line of a map's YAML file with the path of its image


def _read_text_file(path: Path, options: ImportOptions) -> World:
    """Read a drawing, a tb2rl world in YAML, or a ROS map, whose YAML file has the key `image`."""
    if (size := path.stat().st_size) > _MAX_FILE_SIZE:
        raise InputError(f"{path} is too large: {size >> 10} kB, the limit is {_MAX_FILE_SIZE >> 10} kB")
    content = {"drawing": read_text(path)} if path.suffix == ".txt" else read_yaml(path)
    if isinstance(content, Mapping) and "image" in content:
        return read_map(path, content, options)
    return parse_world(content, path.stem, options)


READERS: dict[str, Callable[..., World]] = {  # functions of a path and `ImportOptions`, by file extension
    ".sdf": read_sdf,
    ".txt": _read_text_file,
    ".world": read_sdf,
    ".yaml": _read_text_file,
    ".yml": _read_text_file,
}


def world_names() -> list[str]:
    """Names of the built-in worlds."""
    return sorted(file.stem for file in _BUILT_IN.glob("*.yaml"))


def world_extensions() -> list[str]:
    """File extensions of all readers, both built-in and from entry points."""
    return sorted({*READERS, *_entry_points()})


def find_world(reference: str, options: ImportOptions | None = None) -> World:
    """Find a world by built-in name, file path, "module:reader:path" or "module:WORLD".

    A reader is a function from a path to a `World`. WORLD is a `World`, or a function without arguments that returns a
    `World`. Functions must have the return annotation `World`. Entry points of the group `tb2rl.worlds` map file
    extensions to readers. `options`, such as the start, take precedence over a file, and do not change a WORLD.

    Raises:
        InputError: If there is no such world, or its file is invalid.
    """
    code = WORLD_OR_READER.fullmatch(reference)
    if code is None:
        path = find_file(reference, _BUILT_IN, "world")
        readers: Mapping[str, Any] = {**_entry_points(), **READERS}
        if path.suffix not in readers:
            raise unknown(f"extension of the world file {one_line(reference, 100)}:", path.suffix, readers)
        reader = readers[path.suffix]
        found: Any = read_world(path, find_maker(reader, "path") if isinstance(reader, str) else reader, options)
    elif code["path"] is None:
        found = find_plugin("world", code[1])
        found = found if isinstance(found, World) else find_maker(code[1])()
    else:
        if not os.path.isfile(code["path"]):  # noqa: PTH113 (Path.is_file raises for a name that is too long)
            raise InputError(one_line(f"there is no world file {code['path']}"))
        found = read_world(Path(code["path"]), find_maker(code[1], "path"), options)
    if not isinstance(found, World):
        raise InputError(one_line(f"world {reference!r} is not a tb2rl.worlds.World but {type(found).__name__}"))
    return found


def find_maker(reference: str, *arguments: str) -> Callable[..., World]:
    """Find a function that makes worlds.

    The return annotation of the function must be `World`, because an untrusted config can refer to any function, such
    as `os.remove`. `arguments` are names for the positional arguments with which the caller will call it.

    Raises:
        InputError: If there is no such function, it has another annotation, or it does not take these arguments.
    """
    found, name = find_plugin("world", reference), reference.partition(":")[2]
    try:
        return_type = inspect.isfunction(found) and get_type_hints(found).get("return")
    except Exception:  # the evaluation of annotations can raise any exception
        return_type = None
    if return_type is not World:
        raise InputError(f"world {reference!r}: a function that makes worlds needs the type: def {name}(...) -> World")
    try:
        inspect.signature(found).bind(*arguments)
    except TypeError as error:
        raise InputError(f"world {reference!r} cannot be called as {name}({', '.join(arguments)}): {error}") from None
    return found


def _entry_points() -> dict[str, str]:
    """References to the readers of other packages, by file extension."""
    return {f".{name}": reference for name, reference in entry_point_references("world").items()}


def read_world(path: Path, reader: Callable[..., World] | None = None, options: ImportOptions | None = None) -> World:
    """Read a world from a file; the result is cached until the file, or the image of a map, changes.

    Args:
        path: The world file.
        reader: One of `READERS`, or a function from a path to a `World`; None: that of `READERS` for the extension.
        options: Settings that take precedence over the file.

    Raises:
        InputError: If the file is invalid.
    """
    modified = tuple(file.stat().st_mtime_ns for file in source_files(path))
    return _read(path.resolve(), modified, reader or READERS[path.suffix], options or ImportOptions())


def source_files(path: Path) -> list[Path]:
    """Files of a world: the file itself, and the image of a map; a YAML file without an image is listed twice."""
    files = [path]
    if path.suffix in (".yaml", ".yml") and path.stat().st_size <= _MAX_FILE_SIZE:
        image = _IMAGE.search(path.read_text(encoding="utf-8", errors="replace"))
        file = path.parent / image[1].strip(" \t\r'\"") if image else path
        files += [file] if os.path.isfile(file) else []  # noqa: PTH113 (Path.is_file raises for a name that is too long)
    return files


@lru_cache(maxsize=32)
def _read(path: Path, _modified: tuple[int, ...], reader: Callable[..., World], options: ImportOptions) -> World:
    if reader in READERS.values():
        return reader(path, options)
    world = reader(path)  # a user's reader; `find_world` checks the type of the result
    return world.with_changes(options.start, options.goal, options.bounds) if isinstance(world, World) else world
