"""Checkpoints come back to the bit; a failed write leaves the old file."""

import errno
import os
from collections import deque
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
import torch as th

from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint

VALUES = [
    *(None, True, False, 0, -1, 2**64, -(2**127), 10**300, 0.1, -0.0, 1e-320, 1.7e308, float("inf"), float("-inf")),
    *("", "ü\0\n\\\"'", "\ud800", "$array", [], {}, [[]], [{}], [None, [True, {"a": []}]], {"a": {"b": {"": 1}}}),
]


def round_trip(tree: dict[str, Any], folder) -> dict[str, Any]:
    write_checkpoint(folder / "tree.safetensors", tree)
    return read_checkpoint(folder / "tree.safetensors")


def same(one: Any, other: Any) -> bool:
    """Equal in value and type, recursively."""
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return repr(one) == repr(other)


def test_plain_values_come_back(tmp_path):
    found = round_trip({"values": [*VALUES, float("nan")]}, tmp_path)["values"]
    assert [(a, b) for a, b in zip(found, VALUES, strict=False) if not same(a, b)] == []
    assert np.isnan(found[-1])


def test_other_sequences_come_back_as_lists_and_other_keys_as_text(tmp_path):
    tree = {"tuple": (1, (2, 3)), "deque": deque([1.5, {"r": 1}]), "numbers": [np.float32(0.5), np.int64(3), np.True_]}
    found = round_trip({**tree, "state": {0: {"step": 1}}}, tmp_path)
    assert found.pop("state") == {"0": {"step": 1}}
    assert found == {"tuple": [1, [2, 3]], "deque": [1.5, {"r": 1}], "numbers": [0.5, 3, True]}
    assert [type(number) for number in found["numbers"]] == [float, int, bool]


@pytest.mark.parametrize(
    ("dtype", "shape"), [("bool", (3,)), ("uint8", ()), ("uint16", (3, 0, 2)), ("float16", (4,)), ("float64", (2, 1))]
)
def test_arrays_come_back(dtype, shape, tmp_path):
    bits = np.random.default_rng(0).integers(0, 2 if dtype == "bool" else 256, size=(*shape, 8), dtype=np.uint8)
    array = bits.view(dtype)[..., 0]
    found = round_trip({"list": [array], "tensor": th.from_numpy(array.copy())}, tmp_path)
    for one in (found["list"][0], found["tensor"]):
        assert (type(one), one.dtype, one.shape) == (np.ndarray, array.dtype, shape)
        assert one.tobytes() == array.tobytes(), "to the bit, whatever NaN it is"


def test_arrays_in_any_memory_layout_come_back(tmp_path):
    array = np.arange(24.0).reshape(2, 3, 4)
    views = {"turned": array.T, "reversed": array[::-1], "strided": array[:, ::2, 1::2]}
    views |= {"wide": np.broadcast_to(1.0, (3, 2)), "fortran": np.asfortranarray(array)}
    found = round_trip({**views, "tensor": th.ones(3, 4, requires_grad=True).T}, tmp_path)
    for name, view in views.items():
        np.testing.assert_array_equal(found[name], view)
    assert found["tensor"].shape == (4, 3)
    found["fortran"] += 1  # it is a writable copy


def test_a_real_checkpoint_comes_back_to_the_byte(checkpoint, tmp_path):
    write_checkpoint(tmp_path / "again.safetensors", read_checkpoint(checkpoint))
    assert (tmp_path / "again.safetensors").read_bytes() == checkpoint.read_bytes()


# ---- writes that fail


def no_space(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("function", ["fsync", "replace"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(function, monkeypatch, tmp_path):
    file = tmp_path / "tree.safetensors"
    write_checkpoint(file, {"a": np.ones(3)})
    before = file.read_bytes()
    for value in ({1, object()}, np.array([object()])):
        with suppress(Exception):
            write_checkpoint(file, {"a": value})
    monkeypatch.setattr(os, function, no_space)
    with pytest.raises(OSError, match="No space left"):
        write_checkpoint(file, {"a": np.zeros(3000)})
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]
