"""Random damage to the bytes, to the description of arrays, and to the tree of a checkpoint."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

Header = dict[str, Any]
NAN, INF = float("nan"), float("inf")
BAD_VALUES: list[Any] = [
    *(None, True, 0, -1, 0.5, 1e308, NAN, -INF, 10**9, 10**12, -(10**18), -(10**400), 2**63, 2**64),
    *([], {}, [[]], {"a": 1}, {"": None}, "", "\0", "a\nb", "ü", "x" * 10**5, [0] * 10**4, [2**64] * 625),
    *(":", "os:system", "no.such.module:X", "torch:load", "torch.nn:Linear", "../../etc/passwd"),
    *({"$array": "0"}, {"$array": "none"}, {"$pairs": []}, {"$pairs": [[None, 1], [0, 2]]}, {"start": 1.0, "end": 0.0}),
]


def damaged(runs: Path, number: int) -> tuple[str, bytes]:
    """The agent and the content of a checkpoint of these runs with some damage; equal numbers do equal damage."""
    rng = random.Random(number)
    files = {file.parents[1].name: file.read_bytes() for file in sorted(runs.glob("*/checkpoints/*"))}
    agent = rng.choice(list(files))
    damage = rng.choices(list(DAMAGES), weights=list(DAMAGES.values()))[0]
    if damage in (flip_bits, change_length):
        return agent, damage(rng, files[agent])
    if damage is mix_agents:
        return agent, mix_agents(rng, split(files[agent]), split(files[rng.choice([n for n in files if n != agent])]))
    return agent, damage(rng, *split(files[agent]))


# ---- the file: a length, a JSON header that describes arrays and holds the tree, and the arrays' bytes


def split(content: bytes) -> tuple[Header, bytes]:
    length = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def joined(header: Header, data: bytes) -> bytes:
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def array_names(header: Header) -> list[str]:
    return [name for name in header if name != "__metadata__"]


def tree_of(header: Header) -> Any:
    return json.loads(header["__metadata__"]["tb2rl"])["content"]


def with_tree(header: Header, data: bytes, tree: Any) -> bytes:
    return joined({**header, "__metadata__": {"tb2rl": json.dumps({"format": 2, "content": tree})}}, data)


def some_place(rng: random.Random, tree: Any) -> tuple[Any, Any]:
    """A random branch and a key in it; siblings are equally likely, whatever the size of what is below them."""
    while True:
        key = rng.choice(list(tree) if isinstance(tree, dict) else range(len(tree)))
        if not isinstance(tree[key], dict | list) or not tree[key] or rng.random() < 0.15:
            return tree, key
        tree = tree[key]


# ---- damages


def flip_bits(rng: random.Random, content: bytes) -> bytes:
    flipped = bytearray(content)
    until = 8 + int.from_bytes(content[:8], "little") if rng.random() < 0.5 else len(content)
    for _ in range(rng.choice([1, 1, 2, 10, 100])):
        flipped[rng.randrange(until)] ^= 1 << rng.randrange(8)
    return bytes(flipped)


def change_length(rng: random.Random, content: bytes) -> bytes:
    return content + rng.randbytes(1000) if rng.random() < 0.3 else content[: rng.randrange(len(content))]


def spoil_array(rng: random.Random, header: Header, data: bytes) -> bytes:
    """Numbers out of every range."""
    first, last = header[rng.choice(array_names(header))]["data_offsets"]
    spoiled = rng.choice([rng.randbytes(last - first), b"\xff" * (last - first)])
    return joined(header, data[:first] + spoiled + data[last:])


def describe_array_otherwise(rng: random.Random, header: Header, data: bytes) -> bytes:
    """Another type or shape of an array, some with as many bytes as before."""
    entry = header[rng.choice(array_names(header))]
    count = (entry["data_offsets"][1] - entry["data_offsets"][0]) or 1
    sizes = {"U8": 1, "BOOL": 1, "F8_E4M3": 1, "F4": 0.5, "BF16": 2, "F16": 2, "I32": 4, "F32": 4, "F64": 8, "C64": 8}
    lies: list[Any] = [{"dtype": kind, "shape": [int(count / size)]} for kind, size in sizes.items()]
    lies += [{"dtype": rng.choice(["", "O", "F128", None, 3])}]
    lies += [{"shape": rng.choice([[], [0], [2**63, 2], [2**64], [-1], [1.5], None, "3", [1] * 100, [10**9] * 9])}]
    lies += [{"shape": entry["shape"][::-1]}, {"shape": [*entry["shape"], 1]}]
    lies += [{"data_offsets": rng.choice([[0, 0], [0, 2**63], [8, 0], [-1, 8], [0], None])}]
    entry.update(rng.choice(lies))
    return joined(header, data)


def swap_arrays(rng: random.Random, header: Header, data: bytes) -> bytes:
    one, other = rng.sample(array_names(header), 2)
    return joined({**header, one: header[other], other: header[one]}, data)


def mix_agents(rng: random.Random, mine: tuple[Header, bytes], other: tuple[Header, bytes]) -> bytes:
    """The tree of one agent over the arrays of another, or with a branch of the other's tree."""
    (header, data), (theirs, others) = mine, other
    if rng.random() < 0.3:
        return joined({**theirs, "__metadata__": header["__metadata__"]}, others)
    tree, branch = tree_of(header), rng.choice(["policy", "config", "training"])
    return with_tree(header, data, {**tree, branch: tree_of(theirs)[branch]})


def replace_values(rng: random.Random, header: Header, data: bytes) -> bytes:
    tree = tree_of(header)
    for _ in range(rng.choice([1, 1, 1, 3])):
        branch, key = some_place(rng, tree)
        branch[key] = rng.choice(BAD_VALUES)
    return with_tree(header, data, tree)


def remove_value(rng: random.Random, header: Header, data: bytes) -> bytes:
    tree = tree_of(header)
    branch, key = some_place(rng, tree)
    del branch[key]
    return with_tree(header, data, tree)


def replace_json(rng: random.Random, header: Header, data: bytes) -> bytes:
    deep = rng.choice([100, 990, 100_000])
    contents = ["null", '{"$array": "0"}', '{"$pairs": [[[], 1]]}', '{"$pairs": 3}', "[" * deep + "]" * deep]
    texts = ["", "null", "[]", "{", "1e999", "x" * 10**6, '{"format": 2}', '{"format": [2]}']
    texts += [f'{{"format": 2, "content": {content}}}' for content in contents]
    return joined({**header, "__metadata__": rng.choice([{"tb2rl": rng.choice(texts)}, {"tb2rl": 3}, {}, None])}, data)


DAMAGES: dict[Callable[..., bytes], int] = {  # with weights
    flip_bits: 4,
    change_length: 3,
    spoil_array: 3,
    describe_array_otherwise: 6,
    swap_arrays: 3,
    mix_agents: 3,
    replace_values: 14,
    remove_value: 6,
    replace_json: 3,
}
