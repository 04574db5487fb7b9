"""A pickle in every array's bytes, and in place of every value of the tree, as text or base64."""

from __future__ import annotations

import base64
import os
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path

from surgery import (
    Case,
    arrays_of,
    changed_at,
    checkpoint_of,
    header_content,
    joined,
    packed,
    places,
    split,
    with_content,
)


class Payload:
    """What an attacker hides in a pickle: here it makes a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable, tuple[str]]:
        return os.mkdir, (str(self.folder),)


def pickles(runs: Path, agent: str, marker: Path) -> Iterator[Case]:
    header, data = split(checkpoint_of(runs, agent).read_bytes())
    plain = pickle.dumps(Payload(marker), 2)
    for name, entry in arrays_of(header).items():
        first, last = entry["data_offsets"]
        inside = data[:first] + plain.ljust(last - first, b".")[: last - first] + data[last:]
        yield Case(f"in array {name}", agent, joined(header, inside), resumes=True)
        changed = {**header, name: {"dtype": "U8", "shape": [len(plain)], "data_offsets": [len(data), -1]}}
        yield Case(f"for array {name}", agent, packed(changed, {name: plain}, data), resumes=True)
    content = header_content(header)
    texts = [pickle.dumps(Payload(marker), 0).decode("latin-1"), base64.b64encode(plain).decode()]
    for i, path in enumerate(places(content)):
        yield Case(f"at {path}", agent, with_content(header, data, changed_at(content, path, texts[i % 2])), i % 3 == 0)
