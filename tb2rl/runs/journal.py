"""Results of long work as JSON lines, from which an interrupted program continues."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import write_text


class Journal:
    """A file of JSON lines: a description of the work, then its results.

    Args:
        path: The file; None: nothing is kept.
        work: Description of the work, as plain values; results of other work are discarded.

    Attributes:
        path: The file.
        entries: Results of an earlier program, as plain values.
        mismatch: Key of `work` in which the file differed; None: it did not, or there was no file.

    Raises:
        InputError: If the file cannot be read or written, or is damaged.
    """

    def __init__(self, path: Path | None, work: Mapping[str, Any]) -> None:
        self.path, self.entries, self.mismatch = path, list[Any](), None
        if path is None:
            return
        work = json.loads(json.dumps(work))
        try:
            before, *entries = (read_lines(path) if path.is_file() else []) or [work]
            if before == work:
                self.entries = entries
            else:
                self.mismatch = _first_difference(before, work)
            write_text(path, "".join(json.dumps(line) + "\n" for line in (work, *self.entries)))
        except OSError as error:
            raise InputError(f"cannot keep results in {path}: {error.strerror or error}") from None

    def append(self, entry: Any) -> None:
        """Keep a result, even if this process is killed next."""
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(entry) + "\n")

    def remove(self) -> None:
        """Remove the file of finished work."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def read_lines(path: Path) -> list[Any]:
    """Parse a file of JSON lines; an incomplete last line is ignored.

    A crash of the machine can leave such a line, or zero bytes in its place.

    Raises:
        InputError: If another line is not JSON.
        OSError: If the file cannot be read.
    """
    *lines, last = path.read_bytes().split(b"\n")
    found: list[Any] = []
    for number, line in enumerate(lines, 1):
        if line.strip(b"\0 \t\r"):
            try:
                found.append(json.loads(line))
            except (ValueError, RecursionError) as error:
                raise InputError(one_line(f"{path} is damaged: line {number} is not JSON: {error}")) from None
    with suppress(ValueError, RecursionError):
        found.append(json.loads(last))
    return found


def _first_difference(before: Any, work: Mapping[str, Any]) -> str:
    if not isinstance(before, Mapping):
        return "kind"
    return next(key for key in (*work, *before) if before.get(key) != work.get(key))
