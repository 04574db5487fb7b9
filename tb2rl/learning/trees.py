"""Trees of values: what of an algorithm or an environment is saved, and how it is held against an example again.

A checkpoint may come from anybody, and compiled code trusts the arrays that it is given: a tree that comes back must
have the names, shapes and types of the one that is there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch as th


def is_value(value: Any) -> bool:
    """Whether a value can be saved: a number, an array, a tensor, a queue, or a tuple or mapping of these."""
    if isinstance(value, Mapping):
        return bool(value) and all(map(is_value, value.values()))
    if isinstance(value, tuple):
        return bool(value) and all(map(is_value, value))
    return isinstance(value, bool | int | float | np.ndarray | np.generic | th.Tensor | deque)


def like(example: Any, value: Any, where: str) -> Any:
    """A tree from a checkpoint in the form of an example: tuples where it has tuples, tensors where it has tensors.

    Args:
        example: Of the present training.
        value: Lists, mappings, arrays and plain values.
        where: What the tree is, for the message.

    Raises:
        ValueError: If it has other names, shapes or types than the example, or a number that is not finite.
    """
    if isinstance(example, th.Tensor):
        return th.from_numpy(like(example.detach().cpu().numpy(), value, where)).to(example.device)
    if isinstance(example, np.generic):
        example = example.item()
    if isinstance(example, np.ndarray):
        fits = isinstance(value, np.ndarray) and (value.shape, value.dtype) == (example.shape, example.dtype)
    elif isinstance(example, Mapping):
        if isinstance(value, Mapping) and value.keys() == example.keys():
            return {key: like(part, value[key], f"{where}.{key}") for key, part in example.items()}
        fits = False
    elif isinstance(example, deque):
        if isinstance(value, list):
            return deque(value, maxlen=example.maxlen)
        fits = False
    elif isinstance(example, list | tuple):
        if isinstance(value, list) and len(value) == len(example):
            parts = [
                like(part, other, f"{where}.{i}") for i, (part, other) in enumerate(zip(example, value, strict=True))
            ]
            return type(example)(*parts) if hasattr(example, "_fields") else type(example)(parts)
        fits = False
    elif isinstance(example, float):
        fits = type(value) in (int, float) and math.isfinite(value)
    else:
        fits = type(value) is type(example)
    if not fits:
        raise ValueError(f"{where} has another form, or is not a finite number")
    return value
