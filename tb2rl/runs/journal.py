"""Journals: files of JSON lines with the results of long work, so that an interrupted program can continue."""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tb2rl.core import InputError, one_line, write_text


class Journal:
    """A file of JSON lines: a description of the work, then its results.

    Args:
        path: Path of the file; None: no file.
        work: Description of the work, as plain values; results of other work are discarded.

    Attributes:
        entries: Results of an earlier program, as plain values.
        mismatch: First key of `work` whose value differs from that in the file; None: no difference, or no file.
    """

    def __init__(self, path: Path | None, work: Mapping[str, Any]) -> None:
        self.path, self.entries, self.mismatch = path, list[Any](), None
        if path is None:
            return
        work = json.loads(json.dumps(work))
        earlier_work, *entries = (read_lines(path) if path.is_file() else []) or [work]
        if earlier_work == work:
            self.entries = entries
        else:
            self.mismatch = next((key for key in work if earlier_work.get(key) != work[key]), "kind")
        write_text(path, "".join(json.dumps(line) + "\n" for line in (work, *self.entries)))

    def append(self, entry: Any) -> None:
        """Append a result, which is kept even if this process is killed afterwards."""
        if self.path is not None:
            append_line(self.path, entry)

    def remove(self) -> None:
        """Remove the file of finished work."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def append_line(path: Path, entry: Any) -> None:
    """Append a line of JSON to a file, and wait until the disk has stored it."""
    with path.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(entry) + "\n")
        stream.flush()
        os.fsync(stream.fileno())


def read_lines(path: Path) -> list[Any]:
    """Read a file of JSON lines; ignore an incomplete last line and zero bytes, which a crash can leave."""
    *lines, last_line = path.read_bytes().split(b"\n")
    try:
        entries = [json.loads(line) for line in lines if line.strip(b"\0 \t\r")]
    except (ValueError, RecursionError) as error:
        raise InputError(one_line(f"{path} is damaged: a line is not JSON: {error}")) from None
    with suppress(ValueError, RecursionError):
        entries.append(json.loads(last_line))
    return entries
