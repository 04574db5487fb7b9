"""Values that a checkpoint holds of algorithms and environments: which ones, and how they are restored.

A checkpoint may come from an untrusted source, and compiled code trusts its arrays. A restored tree must therefore have
the names, shapes and types of the present one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch as th


def is_saved(value: Any) -> bool:
    """Whether a checkpoint can hold a value: a number, an array, a tensor, a deque, or a tuple or mapping of these."""
    if isinstance(value, Mapping | tuple):
        return bool(value) and all(map(is_saved, value.values() if isinstance(value, Mapping) else value))
    return isinstance(value, bool | int | float | np.ndarray | np.generic | th.Tensor | deque)


def restore_into(present: Any, saved: Any, path: str) -> Any:
    """Restore a tree of a checkpoint in the form of the present one.

    Arrays are written into the present ones, because their memory layout can change how a network rounds.

    Args:
        present: The tree of the training as it is now.
        saved: Lists, mappings, arrays and plain values.
        path: Name of the tree, for the message.

    Raises:
        ValueError: If the trees differ in names, shapes or types, or a number is not finite.
    """
    if isinstance(present, th.Tensor):
        return th.from_numpy(restore_into(present.detach().cpu().numpy(), saved, path)).to(present.device)
    if isinstance(present, np.ndarray):
        if isinstance(saved, np.ndarray) and (saved.shape, saved.dtype) == (present.shape, present.dtype):
            present[...] = saved
            return present
    elif isinstance(present, Mapping):
        if isinstance(saved, Mapping) and saved.keys() == present.keys():
            return {key: restore_into(part, saved[key], f"{path}.{key}") for key, part in present.items()}
    elif isinstance(present, deque):
        if isinstance(saved, list):
            entries = [tuple(entry) if isinstance(entry, list) else entry for entry in saved]
            if all(map(is_saved, entries)) and len(set(map(np.shape, entries))) <= 1:
                return deque(entries, maxlen=present.maxlen)
    elif isinstance(present, list | tuple):
        if isinstance(saved, list) and len(saved) == len(present):
            parts = [restore_into(part, saved[i], f"{path}.{i}") for i, part in enumerate(present)]
            return type(present)(*parts) if hasattr(present, "_fields") else type(present)(parts)
    elif _has_type(saved, present.item() if isinstance(present, np.generic) else present):
        return saved
    raise ValueError(f"{path}: shape or dtype mismatch, or not a finite number")


def _has_type(saved: Any, present: Any) -> bool:
    """Whether a plain value has the type of the present one; an integer can stand for a float."""
    if isinstance(present, float):
        return type(saved) in (int, float) and math.isfinite(saved)
    return type(saved) is type(present)
