"""Files: found by name, read as text or YAML, replaced atomically."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

import tb2rl
from tb2rl.core.errors import InputError, one_line, unknown

_DEEPEST = 100  # levels of nested lists and mappings
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # compiled if available: three times as fast


def top_folder(name: str) -> Path:
    """The folder `agents`, `configs` or `zoo`: beside the package in a checkout, inside it when installed."""
    return next(folder for place in tb2rl.__path__ if (folder := Path(place, name)).is_dir())


def is_path(name: str) -> bool:
    """Whether a name is a path, with an ending or a folder, and not the name of a built-in file."""
    path = Path(name)
    return path.suffix != "" or path.parent != Path()


def find_file(name: str, folder: Path, kind: str) -> Path:
    """The file of a path (see `is_path`), or of the name of a built-in YAML file in `folder`.

    Raises:
        InputError: If there is no such file; the message names its `kind`, such as "world".
    """
    path = Path(name)
    if is_path(name):
        if not os.path.isfile(path):  # noqa: PTH113 (Path.is_file raises for a name that is too long)
            raise InputError(one_line(f"there is no {kind} file {name}"))
        return path
    built_in = {file.stem: file for file in folder.glob("*.yaml")}
    if name not in built_in:
        raise unknown(kind, name, built_in)
    return built_in[name]


def read_text(path: Path) -> str:
    """The content of a UTF-8 file without a byte order mark."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {path}: {error}") from None


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; an empty file is an empty mapping."""
    content = parse_yaml(read_text(path), str(path))
    return {} if content is None else content


def parse_yaml(text: str, where: str) -> Any:
    """The plain value of a YAML text.

    Aliases are refused because they can expand a few lines to gigabytes, deep nesting because it can crash the parser.

    Raises:
        InputError: If it is not YAML; the message begins with `where`.
    """
    try:
        _check_events(text)
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(one_line(f"{where} is not YAML: {error}")) from None
    except (AttributeError, ArithmeticError, LookupError, TypeError) as error:  # KeyError for "!!bool maybe"
        raise InputError(one_line(f"{where} is not YAML: a value does not fit its tag: {error}")) from None


def _check_events(text: str) -> None:
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError("it uses an alias (*name); write the value out")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise yaml.YAMLError(f"it is nested more than {_DEEPEST} deep")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path that replaces `path` if the block succeeds, and is removed if it fails."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file atomically.

    Raises:
        OSError: If it cannot be written; the old file stays.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
