"""Worlds by name, file, or reference to code."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import find_file, top_folder
from tb2rl.core.plugins import entry_point_references, find_plugin
from tb2rl.worlds.formats.imports import ImportOptions
from tb2rl.worlds.readers import READERS, read_world
from tb2rl.worlds.world import World

MADE_BY_CODE = re.compile(r"([A-Za-z_][\w.]*:[A-Za-z_]\w*)(?::(.+))?")  # module:WORLD, or module:reader:path


def world_names() -> list[str]:
    """Names of the built-in worlds."""
    return sorted(file.stem for file in _worlds_folder().glob("*.yaml"))


def world_endings() -> list[str]:
    """Endings of world files that a built-in reader or an entry point reads."""
    return sorted({*READERS, *_reader_references()})


def find_world(reference: str, said: ImportOptions | None = None) -> World:
    """The world of a built-in name, of a file's path, of "module:reader:path" or of "module:WORLD".

    A reader is a function from a path to a `World`; WORLD is a `World`, or a function without arguments that makes one.
    Functions declare this by their return annotation. Entry points of the group `tb2rl.worlds` map file endings to
    readers.

    Args:
        reference: What names the world.
        said: Settings beside a file, such as the start.

    Raises:
        InputError: If there is none, or its file does not describe a world.
    """
    code = MADE_BY_CODE.fullmatch(reference)
    if code is None:
        path = find_file(reference, _worlds_folder(), "world")
        found: Any = read_world(path, READERS.get(path.suffix) or _entry_point_reader(reference, path.suffix), said)
    elif code[2] is None:
        found = find_plugin("world", code[1])
        found = found if isinstance(found, World) else _made(code[1])
    else:
        if not os.path.isfile(code[2]):  # noqa: PTH113 (Path.is_file raises for a name that is too long)
            raise InputError(one_line(f"there is no world file {code[2]}"))
        if not inspect.signature(world_maker(code[1])).parameters:
            raise InputError(one_line(f"world {reference!r}: {code[1]} reads no file; write {code[1]}"))
        reader = world_maker(code[1], "path")
        found = read_world(Path(code[2]), reader, said)
    if not isinstance(found, World):
        raise InputError(one_line(f"world {reference!r} is not a tb2rl.worlds.World but {type(found).__name__}"))
    return found


def world_maker(reference: str, *arguments: str) -> Callable[..., World]:
    """The function "module:function" that makes worlds.

    An untrusted config can name a function, so only those annotated with `-> World` are called, never `os.remove`.

    Args:
        reference: The function.
        *arguments: Names of the positional arguments that it will be called with; none: unknown.

    Raises:
        InputError: If it is not such a function, or does not take the arguments.
    """
    found, name = find_plugin("world", reference), reference.partition(":")[2]
    try:
        returned = inspect.isfunction(found) and get_type_hints(found).get("return")
    except Exception:  # an annotation can be any code
        returned = None
    if returned is not World:
        raise InputError(f"world {reference!r}: a function that makes worlds says so: def {name}(...) -> World")
    try:
        if arguments:
            inspect.signature(found).bind(*arguments)
    except TypeError as error:
        call = f"{name}({', '.join(arguments)})"
        raise InputError(f"world {reference!r} cannot be called as {call}: {error}") from None
    return found


def _made(reference: str) -> World:
    maker = world_maker(reference)
    if any(argument.default is argument.empty for argument in inspect.signature(maker).parameters.values()):
        raise InputError(f"world {reference!r} reads files; write {reference}:PATH")
    return maker()


def _entry_point_reader(reference: str, ending: str) -> Callable[[Path], World]:
    readers = _reader_references()
    if ending not in readers:
        raise unknown(f"ending of the world file {one_line(reference, 100)}:", ending, world_endings())
    return world_maker(readers[ending], "path")


def _reader_references() -> dict[str, str]:
    return {f".{name}": reference for name, reference in entry_point_references("world").items()}


def _worlds_folder() -> Path:
    return top_folder("configs") / "worlds"
