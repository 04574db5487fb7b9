"""Random damage: to the bytes, to the description of arrays, and to the tree of a checkpoint."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from surgery import (
    Case,
    agents,
    arrays_of,
    at,
    changed_at,
    checkpoint_of,
    header_content,
    joined,
    packed,
    some_place,
    split,
    with_content,
)

Files = dict[str, bytes]


def damage(runs: Path, count: int) -> Iterator[Case]:
    files = {agent: checkpoint_of(runs, agent).read_bytes() for agent in agents(runs)}
    weights = list(DAMAGES.values())
    for i in range(count):
        rng = random.Random(i)
        how = rng.choices(list(DAMAGES), weights=weights)[0]
        agent = rng.choice(list(files))
        yield Case(f"{i}: {how.__name__}", agent, how(rng, agent, files), resumes=i % 2 == 0)


# ---- bytes


def flipped(rng: random.Random, agent: str, files: Files) -> bytes:
    content = bytearray(files[agent])
    until = 8 + int.from_bytes(content[:8], "little") if rng.random() < 0.5 else len(content)
    for _ in range(rng.choice([1, 1, 2, 10, 100])):
        content[rng.randrange(until)] ^= 1 << rng.randrange(8)
    return bytes(content)


def flipped_data(rng: random.Random, agent: str, files: Files) -> bytes:
    """Random bits in one small array: numbers out of every range."""
    header, data = split(files[agent])
    first, last = rng.choice(list(arrays_of(header).values()))["data_offsets"]
    return joined(header, data[:first] + rng.randbytes(last - first) + data[last:])


def other_length(rng: random.Random, agent: str, files: Files) -> bytes:
    if rng.random() < 0.3:
        return files[agent] + rng.randbytes(rng.choice([1, 8, 1000]))
    return files[agent][: rng.randrange(len(files[agent]))]


# ---- arrays


def other_array_description(rng: random.Random, agent: str, files: Files) -> bytes:
    """Another type or shape of an array, some with as many bytes as before."""
    header, data = split(files[agent])
    entry = arrays_of(header)[rng.choice(list(arrays_of(header)))]
    count = (entry["data_offsets"][1] - entry["data_offsets"][0]) or 1
    sizes = {"U8": 1, "BOOL": 1, "F8_E4M3": 1, "F4": 0.5, "BF16": 2, "F16": 2, "I32": 4, "F32": 4, "F64": 8, "C64": 8}
    lies: list[dict[str, Any]] = [{"dtype": kind, "shape": [int(count / size)]} for kind, size in sizes.items()]
    lies += [{"dtype": rng.choice(["", "O", "F128", None, 3])}]
    lies += [{"shape": rng.choice([[], [0], [2**63, 2], [2**64], [-1], [1.5], None, "3", [1] * 100])}]
    lies += [{"shape": [10**9] * 9}, {"shape": entry["shape"][::-1]}, {"shape": [*entry["shape"], 1]}]
    lies += [{"data_offsets": rng.choice([[0, 0], [0, 2**63], [8, 0], [-1, 8], [0], None])}]
    entry.update(rng.choice(lies))
    return joined(header, data)


def empty_array(rng: random.Random, agent: str, files: Files) -> bytes:
    header, data = split(files[agent])
    name = rng.choice(list(arrays_of(header)))
    dtype = rng.choice([header[name]["dtype"], "U8", "F64"])
    shape = rng.choice([[0], [0, 3], [8, 0], [0, 2**62, 2**62]])
    return packed({**header, name: {"dtype": dtype, "shape": shape}}, {name: b""}, data)


def swapped_arrays(rng: random.Random, agent: str, files: Files) -> bytes:
    header, data = split(files[agent])
    one, other = rng.sample(list(arrays_of(header)), 2)
    return joined({**header, one: header[other], other: header[one]}, data)


def parts_of_another_agent(rng: random.Random, agent: str, files: Files) -> bytes:
    """The tree of one agent over the arrays of another, or with a branch of the other's tree."""
    other = rng.choice([name for name in files if name != agent])
    (header, _), (others, data) = split(files[agent]), split(files[other])
    if rng.random() < 0.3:
        return joined({**others, "__metadata__": header["__metadata__"]}, data)
    mine, theirs = header_content(header), header_content(others)
    branch = rng.choice([("policy",), ("config",), ("training",), *(("training", key) for key in theirs["training"])])
    return with_content(others, data, changed_at(theirs, branch, at(mine, branch)))


# ---- the tree


def replaced_values(rng: random.Random, agent: str, files: Files) -> bytes:
    header, data = split(files[agent])
    content = header_content(header)
    for _ in range(rng.choice([1, 1, 1, 3])):
        content = changed_at(content, some_place(rng, content), rng.choice(BAD_VALUES))
    return with_content(header, data, content)


def edited_value(rng: random.Random, agent: str, files: Files) -> bytes:
    """Another value of the same type."""
    header, data = split(files[agent])
    content = header_content(header)
    path = some_place(rng, content)
    value = at(content, path)
    if isinstance(value, bool) or value is None:
        value = not value
    elif isinstance(value, int | float):
        value = rng.choice([-value, value + 1, value - 1, value * 10**12, value / 3, 0, 2**64])
    elif isinstance(value, str):
        value = rng.choice([value[1:], value + ":x", value + "\n", "../" + value])
    elif isinstance(value, list):
        value = rng.choice([value[1:], value[::-1], [*value, *value], [value], [*value, None]])
    else:
        value = rng.choice([[value], {**value, "more": 1}, list(value.values())])
    return with_content(header, data, changed_at(content, path, value))


def missing_value(rng: random.Random, agent: str, files: Files) -> bytes:
    header, data = split(files[agent])
    content = header_content(header)
    *path, key = some_place(rng, content)
    del at(content, path)[key]
    return with_content(header, data, content)


def other_json(rng: random.Random, agent: str, files: Files) -> bytes:
    header, data = split(files[agent])
    deep = rng.choice([100, 990, 100_000])
    texts = ["", "null", "[]", "{", "1e999", "x" * 10**6, '{"format": 2}', '{"format": [2]}']
    contents = ["null", '{"$array": "0"}', '{"$pairs": [[[], 1]]}', '{"$pairs": 3}', "[" * deep + "]" * deep]
    texts += [f'{{"format": 2, "content": {content}}}' for content in contents]
    return joined({**header, "__metadata__": rng.choice([{"tb2rl": rng.choice(texts)}, {"tb2rl": 3}, {}, None])}, data)


NAN, INF = float("nan"), float("inf")
BAD_VALUES: list[Any] = [
    *(None, True, 0, -1, 0.5, 1e308, NAN, -INF, 10**9, -(10**18), -(10**400), 2**63, 2**64),
    *([], {}, [[]], {"a": 1}, {"": None}, "", "\0", "a\nb", "ü", "x" * 10**5, [0] * 10**4),
    *(":", "os:system", "no.such.module:X", "torch:load", "torch.nn:Linear", "../../etc/passwd"),
    *({"$array": "0"}, {"$array": "none"}, {"$pairs": []}, {"$pairs": [[None, 1], [0, 2]]}),
    *({"start": 1.0, "end": 0.0}, [[[[1]]]]),
]
DAMAGES: dict[Callable[[random.Random, str, Files], bytes], int] = {  # with weights
    flipped: 4,
    flipped_data: 3,
    other_length: 3,
    other_array_description: 6,
    empty_array: 3,
    swapped_arrays: 3,
    parts_of_another_agent: 3,
    replaced_values: 12,
    edited_value: 6,
    missing_value: 6,
    other_json: 3,
}
