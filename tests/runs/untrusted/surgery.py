"""Editing of checkpoint files: header and data, and the tree in the header."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Case:
    """One untrusted file."""

    name: str
    agent: str
    content: bytes
    resumes: bool = False  # whether it is also tried as the latest checkpoint of a run


def agents(runs: Path) -> list[str]:
    return sorted(folder.name for folder in runs.iterdir())


def checkpoint_of(runs: Path, agent: str) -> Path:
    (file,) = (runs / agent / "checkpoints").iterdir()
    return file


# ---- the file


def split(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The header and the data of a safetensors file."""
    length = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def joined(header: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def packed(header: dict[str, Any], new: dict[str, bytes], data: bytes) -> bytes:
    """A consistent file with the arrays of the header in turn, some of them with new bytes."""
    made, parts, place = {"__metadata__": header["__metadata__"]}, [], 0
    for name, entry in arrays_of(header).items():
        part = new[name] if name in new else data[slice(*entry["data_offsets"])]
        made[name] = {**entry, "data_offsets": [place, place + len(part)]}
        parts.append(part)
        place += len(part)
    return joined(made, b"".join(parts))


def arrays_of(header: dict[str, Any]) -> dict[str, Any]:
    return {name: entry for name, entry in header.items() if name != "__metadata__"}


def header_content(header: dict[str, Any]) -> dict[str, Any]:
    """The tree in a header, with references to arrays."""
    return json.loads(header["__metadata__"]["tb2rl"])["content"]


def with_content(header: dict[str, Any], data: bytes, content: Any) -> bytes:
    text = json.dumps({"format": 2, "content": content})
    return joined({**header, "__metadata__": {"tb2rl": text}}, data)


# ---- the tree


def at(tree: Any, path: Any) -> Any:
    for key in path:
        tree = tree[key]
    return tree


def changed_at(tree: Any, path: Any, value: Any) -> Any:
    """A copy of the tree with another value at one place."""
    tree = deepcopy(tree)
    *branch, last = path
    at(tree, branch)[last] = value
    return tree


def children(tree: Any) -> list[Any]:
    return list(tree) if isinstance(tree, dict) else list(range(len(tree))) if isinstance(tree, list) else []


def places(tree: Any, longest: int = 4) -> Iterator[list[Any]]:
    """Paths of all values in a tree; of a long list only the first few."""
    for key in children(tree)[: longest if isinstance(tree, list) else None]:
        yield [key]
        for rest in places(tree[key], longest):
            yield [key, *rest]


def some_place(rng: random.Random, tree: Any) -> list[Any]:
    """A random path, each branch as likely as its siblings, because a generator's state has thousands of numbers."""
    path: list[Any] = []
    while children(tree) and not (path and rng.random() < 0.15):
        path.append(rng.choice(children(tree)))
        tree = tree[path[-1]]
    return path
