"""Checkpoints: files of arrays and plain values, without code.

A safetensors file (no pickle, no archive) holds the arrays; its header holds the rest as JSON, with references to the
arrays. safetensors compares every shape with the bytes present, so a file cannot claim more memory than it has.
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
_ARRAY, _PAIRS = "$array", "$pairs"  # JSON keys of a reference to an array, and of a mapping whose keys are not strings
_DAMAGE = (SafetensorError, AttributeError, KeyError, TypeError, ValueError, RecursionError, MemoryError)


def write_checkpoint(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a tree of mappings, sequences, plain values, arrays and tensors atomically.

    Raises:
        OSError: If it cannot be written; the old file stays.
    """
    arrays: dict[str, np.ndarray] = {}
    content = json.dumps({"format": FORMAT, "content": _pack(tree, arrays)})
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(save(arrays, metadata={"tb2rl": content}))
        file.flush()
        os.fsync(file.fileno())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The tree that `write_checkpoint` wrote, with lists for sequences and arrays for tensors.

    Raises:
        InputError: If there is no such file, or it is not a complete checkpoint of this format.
    """
    if not path.is_file():
        raise InputError(f"there is no checkpoint {path}")
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {})["tb2rl"]
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
        header = json.loads(text)
        if header["format"] == FORMAT:
            return dict(_unpack(header["content"], arrays))
        found = one_line(repr(header["format"]), 50)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from None
    except _DAMAGE as error:
        cause = f"{type(error).__name__}: {error}"
        raise InputError(one_line(f"{path} is not a checkpoint, or is damaged ({cause})")) from None
    raise InputError(f"{path} has checkpoint format {found}; this tb2rl reads {FORMAT}")


def _pack(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """JSON for a value; its arrays are added to `arrays`."""
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
