"""Checkpoints: files of arrays and plain values, without code.

A checkpoint is a safetensors file, which cannot contain code. Its header contains the plain values as JSON, with
references to the arrays. safetensors compares all shapes with the size of the file, so that a damaged file cannot cause
large allocations. `restore_like` compares names, shapes and types with those of the training, because numba's code
does not check them.
"""

import json
import math
import os
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from tb2rl.core import InputError, one_line
from tb2rl.core.files import atomic_write
from tb2rl.runs.arguments import LIBRARY_ERRORS

FORMAT = 2  # version of the files that this version of tb2rl writes and reads
SUFFIX = ".safetensors"
_ARRAY_KEY = "$array"  # JSON key of a reference to an array


def write_checkpoint(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a tree of mappings (with keys of text or integers), sequences, plain values, arrays and tensors atomically.

    Raises:
        OSError: If the file cannot be written; an old file is kept.
    """
    arrays: dict[str, np.ndarray] = {}

    def to_json(value: Any) -> Any:
        if isinstance(value, th.Tensor):
            value = value.detach().cpu().numpy()
        if isinstance(value, np.ndarray):
            name = str(len(arrays))
            arrays[name] = np.asarray(value, order="C")
            return {_ARRAY_KEY: name}
        if isinstance(value, np.generic):
            return value.item()
        return dict(value) if isinstance(value, Mapping) else list(value)

    header = json.dumps({"format": FORMAT, "content": tree}, default=to_json)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(save(arrays, metadata={"tb2rl": header}))
        file.flush()
        os.fsync(file.fileno())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read the tree of a file from `write_checkpoint`; keys are text, sequences are lists, and tensors are arrays.

    Raises:
        InputError: If the file is missing, damaged, or of another format.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
            text = (file.metadata() or {})["tb2rl"]
        header = json.loads(text, object_hook=lambda part: arrays[part[_ARRAY_KEY]] if _ARRAY_KEY in part else part)
        if header["format"] != FORMAT:
            raise ValueError(f"its format is {header['format']!r}, but this version of tb2rl reads {FORMAT}")
        return dict(header["content"])
    except OSError as error:
        raise InputError(one_line(f"cannot read {path}: {error.strerror or error}")) from None
    except (SafetensorError, *LIBRARY_ERRORS) as error:
        raise InputError(one_line(f"{path} is not a checkpoint, or is damaged: {error!r}")) from None


def is_training_state(value: Any) -> bool:
    """Whether an attribute is training state: number, array, tensor, deque, or non-empty tuple or mapping of these."""
    if isinstance(value, Mapping | tuple):
        return bool(value) and all(map(is_training_state, value.values() if isinstance(value, Mapping) else value))
    return isinstance(value, bool | int | float | np.ndarray | np.generic | th.Tensor | deque)


def restore_like(present: Any, saved: Any, where: str) -> Any:
    """Convert a tree from a checkpoint to the types of the present tree.

    Arrays are copied into the present arrays, because the memory layout of weights can affect a network's rounding.

    Args:
        present: Present state of the training.
        saved: Tree from `read_checkpoint`.
        where: Name of the tree, for messages.

    Raises:
        ValueError: If the trees differ in names, shapes or types, or a number is not finite.
    """
    if isinstance(present, th.Tensor):
        return th.from_numpy(restore_like(present.detach().cpu().numpy(), saved, where)).to(present.device)
    if isinstance(present, Mapping) and isinstance(saved, Mapping):
        if differing := saved.keys() ^ set(map(str, present)):
            raise ValueError(f"{where} has missing or unknown attributes: {', '.join(sorted(differing))}")
        return {key: restore_like(part, saved[str(key)], f"{where}.{key}") for key, part in present.items()}
    if isinstance(present, np.ndarray) and isinstance(saved, np.ndarray):
        if (saved.shape, saved.dtype) == (present.shape, present.dtype):
            present[...] = saved
            return present
    elif isinstance(present, deque) and isinstance(saved, list):
        entries = [tuple(entry) if isinstance(entry, list) else entry for entry in saved]
        rows = [[*entry.values()] if isinstance(entry, Mapping) else entry for entry in entries]  # np.shape({}) is ()
        if all(map(is_training_state, entries)) and len(set(map(np.shape, rows))) <= 1:
            return deque(entries, maxlen=present.maxlen)
    elif isinstance(present, list | tuple):
        if isinstance(saved, list) and len(saved) == len(present):
            parts = [restore_like(part, saved[i], f"{where}.{i}") for i, part in enumerate(present)]
            return type(present)(*parts) if hasattr(present, "_fields") else type(present)(parts)
    elif isinstance(present, float | np.floating):  # a checkpoint may contain a whole number as an integer
        if type(saved) in (int, float) and math.isfinite(saved):
            return saved
    elif type(saved) is type(present.item() if isinstance(present, np.generic) else present):
        return saved
    raise ValueError(f"{where}: shape or dtype mismatch, or not a finite number")
