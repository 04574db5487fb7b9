"""Values that cost memory or time, and strange arrays, in the state of a training."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from surgery import Case, agents, at, changed_at, checkpoint_of, header_content, packed, places, split, with_content

NAN = float("nan")
OPTIMIZER = "training/others/policy.optimizer"
STATES: dict[str, list[Any]] = {
    "timesteps": [-1, 10**30, True, None],
    "training": [None, [], {}],
    "training/others": [None, {"policy.optimizer": {}}],
    f"{OPTIMIZER}/param_groups/0/lr": ["x", NAN, 10**400],
    f"{OPTIMIZER}/param_groups/0/params": [[], [10**30]],
    f"{OPTIMIZER}/param_groups": [None, [], [{}]],
    f"{OPTIMIZER}/state": [None, [], {"0": {}}, {"$pairs": [[0, 3]]}],
    "training/algorithm/num_timesteps": [-(10**18), 10**18],
    "training/algorithm/exploration_rate": [NAN, 10**400],
    "training/algorithm/batch_size": [10**12, -1],
    "training/algorithm/n_steps": [10**12, -1],
    "training/algorithm/buffer_size": [10**12],
    "training/algorithm/ep_info_buffer": [[1], [{"r": "x", "l": None}], {}],
    "training/algorithm/_last_obs": [{"$array": "0"}, None],
    "training/algorithm/learn": [1, {"$array": "0"}],
    "training/replay_buffer": [None, {"pos": 1}],
    "training/replay_buffer/pos": [10**12, -1, 41],
    "training/replay_buffer/n_envs": [10**12, 0],
    "training/generators/python/1": [[], [2**64] * 625],
    "training/generators/numpy": [None, "x"],
    "training/generators/torch": [{"$array": "0"}, None],
    "training/environments": [None, {}],
    "training/callbacks": [None, [{}, {}]],
    "training/callbacks/1/next": [10**400, NAN, -1],
}  # fmt: skip
TYPES = {"F32": "float32", "F64": "float64", "I64": "int64", "U32": "uint32", "U64": "uint64"}
TYPES |= {"BOOL": "bool", "U8": "uint8"}


def states(runs: Path) -> Iterator[Case]:
    """States of a training with such values, and with other types, shapes and content of each array."""
    for agent in agents(runs):
        header, data = split(checkpoint_of(runs, agent).read_bytes())
        content = header_content(header)
        for place, values in STATES.items():
            path = [int(key) if key.isdigit() else key for key in place.split("/")]
            for value in values:
                with suppress(KeyError, IndexError, TypeError):  # of another agent
                    changed = changed_at(content, path, value)
                    yield Case(f"{place}={value!r}"[:90], agent, with_content(header, data, changed), resumes=True)
        for path in places(content):
            layer = path[5] if path[:2] == ["training", "others"] and len(path) > 5 else 0
            if path[0] == "training" and path[-1] == "$array" and layer == 0:  # optimisers treat all layers alike
                yield from strange_arrays(agent, header, data, path, at(content, path))


def strange_arrays(agent: str, header: dict[str, Any], data: bytes, path: list[Any], name: str) -> Iterator[Case]:
    entry, place = header[name], "/".join(map(str, path[1:-1]))
    first, last = entry["data_offsets"]
    array = np.frombuffer(data[first:last], TYPES[entry["dtype"]]).reshape(entry["shape"])
    if array.dtype.kind == "f":
        others = [np.full_like(array, value) for value in (np.nan, np.inf)]
    else:
        extremes = (0, 1) if array.dtype.kind == "b" else (np.iinfo(array.dtype).min, np.iinfo(array.dtype).max)
        others = [np.full_like(array, value) for value in extremes]
    others += [array.astype(np.int64), array.astype(bool), array[..., None], array.ravel(), array.reshape(-1)[:0]]
    others += [array[:-1], np.repeat(array, 2, axis=0)] if array.ndim else []
    names = {numpy: name for name, numpy in TYPES.items()}
    for other in others:
        changed = {**header, name: {"dtype": names[other.dtype.name], "shape": list(other.shape)}}
        shown = f"{place}: {other.dtype} {other.shape} {other.reshape(-1)[:1]}"
        yield Case(shown, agent, packed(changed, {name: other.tobytes()}, data), resumes=True)
