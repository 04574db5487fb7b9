"""Files: found by name, read as text or YAML, replaced in one step."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

import tb2rl
from tb2rl.core.errors import InputError, one_line, unknown

_DEEPEST = 100  # lists and mappings in one another
_LONGEST = 400  # [characters] of an integer; Python prints no more than 4300 digits


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """PyYAML's safe loader (compiled where PyYAML has it: three times as fast), with a limit on integers."""


def _integer(loader: Any, node: Any) -> int:
    length = len(loader.construct_scalar(node))
    if length > _LONGEST:
        raise yaml.YAMLError(f"it has an integer of {length} characters")
    return loader.construct_yaml_int(node)


_Loader.add_constructor("tag:yaml.org,2002:int", _integer)


def top_folder(name: str) -> Path:
    """The folder `agents`, `configs` or `zoo`: beside the package in a checkout, inside it when installed."""
    return next(folder for place in tb2rl.__path__ if (folder := Path(place, name)).is_dir())


def is_path(name: str) -> bool:
    """Whether a name is the path of a file, which has an ending or a folder, and not that of a built-in file."""
    path = Path(name)
    return path.suffix != "" or path.parent != Path()


def find_file(name: str, folder: Path, kind: str) -> Path:
    """The file that a user means: a path, or the name of a built-in YAML file in `folder`; `is_path` tells which.

    Args:
        name: What the user wrote.
        folder: Where the built-in files are.
        kind: What the file is, for the message: "world", "preset".

    Raises:
        InputError: If there is no such file.
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
    """The content of a text file in UTF-8, without the byte order mark that some editors put in front.

    Raises:
        InputError: If it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {path}: {error}") from None


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; an empty file is an empty mapping.

    Raises:
        InputError: If it cannot be read, or is not YAML.
    """
    content = parse_yaml(read_text(path), str(path))
    return {} if content is None else content


def parse_yaml(text: str, where: str) -> Any:
    """The plain value that a YAML text means.

    Refused are aliases, which can blow a few lines up to gigabytes, nesting that nobody writes (it can crash the
    parser), and integers that Python does not print.

    Raises:
        InputError: If it is not YAML; the message begins with `where` it stands.
    """
    try:
        _check_events(text)
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, AttributeError, ArithmeticError, LookupError, TypeError) as error:
        said = isinstance(error, yaml.YAMLError | ValueError)  # others name no cause: KeyError for "!!bool maybe"
        why = error if said else f"a value does not fit its tag: {error}"
        raise InputError(one_line(f"{where} is not YAML: {why}")) from None


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
    """A temporary path beside `path` that takes its place when the block ends well; else nothing of it is left."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step: a reader sees the old or the new one, never half of it.

    Raises:
        OSError: If it cannot be written; the old file stands.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
