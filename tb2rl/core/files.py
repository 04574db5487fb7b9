"""Finds files by name, reads text, YAML and folders, and writes files atomically."""

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

import tb2rl
from tb2rl.core.errors import InputError, one_line, unknown

_MAX_DEPTH = 100  # levels of nested lists and mappings
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the compiled loader is three times as fast


def top_folder(name: str) -> Path:
    """The folder `agents`, `configs` or `zoo`: in the package, or beside it in a checkout, see `tb2rl.__path__`."""
    return next(folder for parent in tb2rl.__path__ if (folder := Path(parent, name)).is_dir())


def is_path(name: str) -> bool:
    """Whether a name has a suffix or a folder, and is therefore a path, not the name of a built-in file."""
    path = Path(name)
    return path.suffix != "" or path.parent != Path()


def find_file(name: str, folder: Path, kind: str) -> Path:
    """Find a file by path, or a built-in YAML file in `folder` by name, see `is_path`.

    `kind` is the kind of file for messages, such as "world".

    Raises:
        InputError: If the file does not exist.
    """
    path = Path(name)
    if is_path(name):
        if not os.path.isfile(path):  # noqa: PTH113 (Path.is_file raises an error for a long name)
            raise InputError(one_line(f"there is no {kind} file {name}"))
        return path
    built_in = {file.stem: file for file in folder.glob("*.yaml")}
    if name not in built_in:
        raise unknown(kind, name, built_in)
    return built_in[name]


def read_text(path: Path) -> str:
    """Read a UTF-8 file, with or without a byte order mark.

    Raises:
        InputError: If the file cannot be read, or is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {path}: {error}") from None


def read_yaml(path: Path) -> Any:
    """Read a YAML file; the content of an empty file is an empty mapping."""
    content = parse_yaml(read_text(path), str(path))
    return {} if content is None else content


def parse_yaml(text: str, source: str) -> Any:
    """Parse YAML into plain Python values; `source` is the origin of the text, for messages.

    Raises:
        InputError: If the text is not YAML. Aliases, which can expand a few lines to gigabytes, and deep nesting, which
            can crash the parser, are also rejected.
    """
    try:
        _check_structure(text)
        return yaml.load(text, _Loader)
    except Exception as error:  # also errors of invalid tagged values, such as the KeyError of "!!bool maybe"
        raise InputError(one_line(f"cannot parse {source} as YAML: {error}")) from None


def _check_structure(text: str) -> None:
    """Raise a `YAMLError` for an alias or for deep nesting."""
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError("it uses an alias (*name); write the value out")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise yaml.YAMLError(f"it is nested more than {_MAX_DEPTH} levels deep")


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path, whose file replaces `path` at the end of the block, or is removed after an error."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.filename in (None, str(temporary)):
            error.filename = str(path)  # for the message that commands print
        raise
    finally:
        temporary.unlink(missing_ok=True)


def check_output(file: Path) -> None:
    """Raise an `InputError` if a file cannot be written, to be called before long work."""
    folder = file.absolute().parent
    if file.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(f"cannot write {file}: choose a file in a writable folder")


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file atomically.

    Raises:
        OSError: If the file cannot be written; an old file is kept.
    """
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, tree: Any) -> None:
    """Write plain values as JSON, atomically."""
    write_text(path, json.dumps(tree, indent=1) + "\n")


def read_files(folder: Path) -> dict[str, bytes]:
    """Read all files in a folder; returns their contents by relative path."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def write_files(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files into a temporary folder, then replace `folder` by it."""
    folder = folder.absolute()
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as parent:
        staging = Path(parent, "folder")
        staging.mkdir()
        for name, content in files.items():
            (staging / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).write_bytes(content)
        shutil.rmtree(folder, ignore_errors=True)
        staging.rename(folder)
