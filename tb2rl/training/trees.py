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


def fill(example: Any, value: Any, where: str) -> Any:
    """A tree from a checkpoint in the form of an example: tuples where it has tuples, and its own arrays, written into.

    They keep how they lie in memory, on which rounding in a network can depend.

    Args:
        example: Of the present training.
        value: Lists, mappings, arrays and plain values.
        where: What the tree is, for the message.

    Raises:
        ValueError: If it has other names, shapes or types than the example, or a number that is not finite.
    """
    if isinstance(example, th.Tensor):
        return th.from_numpy(fill(example.detach().cpu().numpy(), value, where)).to(example.device)
    if isinstance(example, np.ndarray):
        if isinstance(value, np.ndarray) and (value.shape, value.dtype) == (example.shape, example.dtype):
            example[...] = value
            return example
    elif isinstance(example, Mapping):
        if isinstance(value, Mapping) and value.keys() == example.keys():
            return {key: fill(part, value[key], f"{where}.{key}") for key, part in example.items()}
    elif isinstance(example, deque):
        if isinstance(value, list):
            return deque(value, maxlen=example.maxlen)
    elif isinstance(example, list | tuple):
        if isinstance(value, list) and len(value) == len(example):
            parts = [fill(part, value[i], f"{where}.{i}") for i, part in enumerate(example)]
            return type(example)(*parts) if hasattr(example, "_fields") else type(example)(parts)
    elif _fits(value, example.item() if isinstance(example, np.generic) else example):
        return value
    raise ValueError(f"{where} has another form, or is not a finite number")


def _fits(value: Any, example: Any) -> bool:
    """Whether a plain value is of the example's kind; a float may come as an integer."""
    if isinstance(example, float):
        return type(value) in (int, float) and math.isfinite(value)
    return type(value) is type(example)
