"""A journal: what takes long is kept line by line, so that it goes on where it was when something stopped it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import write_text

_BLANK = b"\0 \t\r"


class Journal:
    """A file of JSON lines: first what the work is, then each of its results.

    Args:
        path: The file; None: nothing is kept.
        work: What the work is, as plain values; what the file holds of any other work is thrown away.

    Attributes:
        path: The file.
        entries: The results that are there already, as plain values.
        other: In which part of `work` the file was of another one; None: it was not, or there was none.

    Raises:
        InputError: If the file cannot be read or written, or is damaged.
    """

    def __init__(self, path: Path | None, work: Mapping[str, Any]) -> None:
        self.path, self.entries, self.other = path, list[Any](), None
        if path is None:
            return
        work = json.loads(json.dumps(work))
        try:
            before, *entries = (read_lines(path) if path.is_file() else []) or [work]
            if before == work:
                self.entries = entries
            else:
                self.other = _difference(before, work)
            write_text(path, "".join(json.dumps(line) + "\n" for line in (work, *self.entries)))
        except OSError as error:
            raise InputError(f"cannot keep results in {path}: {error.strerror or error}") from None

    def note(self, entry: Any) -> None:
        """Keep a result: it is there even if this process is killed."""
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(entry) + "\n")

    def remove(self) -> None:
        """Remove the file, once the work is done."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def read_lines(path: Path) -> list[Any]:
    """Parse a file of JSON lines, in which a last line that was not written to its end does not count.

    A crash of the machine can leave such a line, or zero bytes in its place.

    Raises:
        InputError: If another line is not JSON.
        OSError: If the file cannot be read.
    """
    *lines, last = path.read_bytes().split(b"\n")
    found: list[Any] = []
    for number, line in enumerate(lines, 1):
        if line.strip(_BLANK):
            try:
                found.append(json.loads(line))
            except (ValueError, RecursionError) as error:
                raise InputError(one_line(f"{path} is damaged: line {number} is not JSON: {error}")) from None
    with suppress(ValueError, RecursionError):
        found.append(json.loads(last))
    return found


def _difference(before: Any, work: Mapping[str, Any]) -> str:
    """The first part of the work that was another."""
    if not isinstance(before, Mapping):
        return "kind"
    return next(key for key in (*work, *before) if before.get(key) != work.get(key))
