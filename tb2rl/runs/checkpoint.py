"""A checkpoint: one file of arrays and plain values, nothing that runs.

A safetensors file (no pickle, no archive): the arrays stand in its data, everything else as JSON in its header, with a
reference where an array belongs. safetensors holds every shape against the bytes that are there, so a file cannot claim
more than it brings.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import replacing

FORMAT = 2
SUFFIX = ".safetensors"
_ARRAY, _PAIRS = "$array", "$pairs"  # how JSON refers to an array, and writes a mapping whose keys are not strings
_DAMAGE = (SafetensorError, AttributeError, KeyError, TypeError, ValueError, RecursionError, MemoryError)


def write_checkpoint(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a tree of mappings, sequences, plain values, arrays and tensors in one step.

    Raises:
        OSError: If it cannot be written; the old file stands.
    """
    arrays: dict[str, np.ndarray] = {}
    content = json.dumps({"format": FORMAT, "content": _pack(tree, arrays)})
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(save(arrays, metadata={"tb2rl": content}))
        file.flush()
        os.fsync(file.fileno())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The tree that `write_checkpoint` wrote; sequences come back as lists, tensors as arrays.

    Raises:
        InputError: If there is no such file, or it is not a whole checkpoint of this format.
    """
    if not path.is_file():
        raise InputError(f"there is no checkpoint {path}")
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {})["tb2rl"]
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
        header = json.loads(text)
        found = header["format"]
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from None
    except _DAMAGE as error:
        raise InputError(one_line(f"{path} is not a checkpoint, or is damaged ({_cause(error)})")) from None
    if found != FORMAT:
        raise InputError(f"{path} has checkpoint format {one_line(repr(found), 50)}; this tb2rl reads {FORMAT}")
    try:
        return dict(_unpack(header["content"], arrays))
    except _DAMAGE as error:
        raise InputError(one_line(f"{path} is damaged ({_cause(error)})")) from None


def _pack(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, th.Tensor):
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        name = str(len(arrays))
        arrays[name] = np.asarray(value, order="C")
        return {_ARRAY: name}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        if all(isinstance(key, str) and not key.startswith("$") for key in value):
            return {key: _pack(part, arrays) for key, part in value.items()}
        return {_PAIRS: [[key, _pack(part, arrays)] for key, part in value.items()]}
    if isinstance(value, str | int | float | bool | None):
        return value
    return [_pack(part, arrays) for part in value]


def _unpack(value: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    if isinstance(value, list):
        return [_unpack(part, arrays) for part in value]
    if not isinstance(value, dict):
        return value
    if _ARRAY in value:
        return arrays[value[_ARRAY]]
    if _PAIRS in value:
        return {key: _unpack(part, arrays) for key, part in value[_PAIRS]}
    return {key: _unpack(part, arrays) for key, part in value.items()}


def _cause(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
