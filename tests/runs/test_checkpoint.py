"""What is written comes back, to the bit; a write that fails leaves the old file."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load

ARRAY_TYPES = ["bool", "uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64"]
ARRAY_TYPES += ["float16", "float32", "float64"]


def round_trip(tree: dict[str, Any], folder: Path) -> dict[str, Any]:
    write_checkpoint(folder / "tree.safetensors", tree)
    return read_checkpoint(folder / "tree.safetensors")


def same(one: Any, other: Any) -> bool:
    """Equal in value and type, all the way down."""
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return repr(one) == repr(other)


@pytest.mark.parametrize(
    "value",
    [
        *(None, True, False, 0, -1, 2**31, 2**63, 2**64, -(2**127), 10**300, 0.1, -0.0, 1e-320, 1.7e308),
        *(float("inf"), float("-inf"), "", "x", "ü\0\n\\\"'", "\ud800", "$array", "$pairs", "NaN", [], {}, [[]], [{}]),
        *([None, [True, {"a": []}]], {"a": {"b": {"c": {"": 1}}}}, {1: {2: {-3: None}}}, {0: "a", 1: {"b": [{2: 3}]}}),
        *({"$array": "0"}, {"$pairs": [[1, 2]]}, {"$pairs": {"$array": 3}}, {"$": 1, "a": {"$array": None}}, {"1": 1}),
        *({1: "int", "1": "str"}, {None: 1, 1.5: 2}, {"format": 7, "content": 8, "tb2rl": 9, "__metadata__": 10}),
    ],
    ids=lambda value: repr(value)[:40],
)
def test_plain_values_come_back(value, tmp_path):
    found = round_trip({"value": value}, tmp_path)["value"]
    assert same(found, value), found


def test_nan_comes_back(tmp_path):
    assert np.isnan(round_trip({"value": float("nan")}, tmp_path)["value"])


def test_other_sequences_come_back_as_lists(tmp_path):
    tree = {"tuple": (1, (2, 3)), "deque": deque([1.5, {"r": 1}]), "numbers": [np.float32(0.5), np.int64(3), np.True_]}
    found = round_trip(tree, tmp_path)
    assert found == {"tuple": [1, [2, 3]], "deque": [1.5, {"r": 1}], "numbers": [0.5, 3, True]}
    assert [type(number) for number in found["numbers"]] == [float, int, bool]


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 0, 2), (2, 3, 4), (1, 1, 1, 1, 1, 1)], ids=str)
@pytest.mark.parametrize("dtype", ARRAY_TYPES)
def test_arrays_come_back(dtype, shape, tmp_path):
    bits = np.random.default_rng(0).integers(0, 2 if dtype == "bool" else 256, size=(*shape, 8), dtype=np.uint8)
    array = bits.view(dtype)[..., 0]
    tree = {"array": array, "list": [array, {5: array}], "tensor": th.from_numpy(array.copy())}
    found = round_trip(tree, tmp_path)
    for one in (found["array"], *found["list"][:1], found["list"][1][5], found["tensor"]):
        assert (type(one), one.dtype, one.shape) == (np.ndarray, array.dtype, shape)
        assert one.tobytes() == array.tobytes(), "to the bit, whatever NaN it is"


def test_arrays_in_any_memory_layout_come_back(tmp_path):
    array = np.arange(24.0).reshape(2, 3, 4)
    views = {
        "turned": array.T,
        "reversed": array[::-1],
        "strided": array[:, ::2, 1::2],
        "wide": np.broadcast_to(1.0, (3, 2)),
    }
    views["fortran"] = np.asfortranarray(array)
    found = round_trip({**views, "tensor": th.ones(3, 4, requires_grad=True).T}, tmp_path)
    for name, view in views.items():
        np.testing.assert_array_equal(found[name], view)
    assert found["tensor"].shape == (4, 3)


def test_what_comes_back_can_be_changed(tmp_path):
    found = round_trip({"array": np.zeros(3)}, tmp_path)["array"]
    found += 1
    assert found.tolist() == [1, 1, 1]
    assert read_checkpoint(tmp_path / "tree.safetensors")["array"].tolist() == [0, 0, 0]


def test_a_real_checkpoint_comes_back_to_the_byte(checkpoint, tmp_path):
    write_checkpoint(tmp_path / "again.safetensors", read_checkpoint(checkpoint))
    assert (tmp_path / "again.safetensors").read_bytes() == checkpoint.read_bytes()


# ---- writes that fail


def no_space(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("function", ["fsync", "replace"])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(function, monkeypatch, tmp_path):
    file = tmp_path / "tree.safetensors"
    write_checkpoint(file, {"a": np.ones(3)})
    before = file.read_bytes()
    monkeypatch.setattr(os, function, no_space)
    with pytest.raises(OSError, match="No space left"):
        write_checkpoint(file, {"a": np.zeros(3000)})
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


def test_a_disk_that_is_full_midway_leaves_the_old_file_and_nothing_else(tmp_path):
    """A real write error: no file of the process may grow beyond 100 kB."""
    program = """
import resource, signal, sys, numpy as np
from pathlib import Path
from tb2rl.runs.checkpoint import write_checkpoint
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
write_checkpoint(Path(sys.argv[1]), {"a": np.ones(3)})
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    write_checkpoint(Path(sys.argv[1]), {"a": np.zeros(10**6)})
except OSError as error:
    print(type(error).__name__)
"""
    file = tmp_path / "tree.safetensors"
    arguments = [sys.executable, "-c", program, str(file)]
    assert subprocess.run(arguments, capture_output=True, text=True, check=True).stdout == "OSError\n"
    assert read_checkpoint(file)["a"].tolist() == [1, 1, 1]
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    "value",
    [object(), {1, 2, object()}, np.array([object()]), np.array(["x"]), np.array([1j])],
    ids=["object", "set", "array of objects", "array of text", "array of complex numbers"],
)
def test_what_cannot_be_written_leaves_the_old_file_and_nothing_else(value, tmp_path):
    file = tmp_path / "tree.safetensors"
    write_checkpoint(file, {"a": 1})
    with suppress(Exception):
        write_checkpoint(file, {"a": value})
    assert read_checkpoint(file)["a"] is not None
    assert list(tmp_path.iterdir()) == [file]


def test_a_write_over_a_folder_leaves_nothing_behind(tmp_path):
    (tmp_path / "tree.safetensors").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_checkpoint(tmp_path / "tree.safetensors", {"a": 1})
    assert list(tmp_path.iterdir()) == [tmp_path / "tree.safetensors"]


def test_a_write_without_a_folder_fails_and_makes_none(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_checkpoint(tmp_path / "none" / "tree.safetensors", {"a": 1})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_write_into_a_folder_that_may_not_be_written_leaves_the_old_file(tmp_path):
    file = tmp_path / "tree.safetensors"
    write_checkpoint(file, {"a": 1})
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(PermissionError):
            write_checkpoint(file, {"a": 2})
        assert read_checkpoint(file) == {"a": 1}
        assert list(tmp_path.iterdir()) == [file]
    finally:
        tmp_path.chmod(0o700)


def test_a_run_that_cannot_save_says_so_in_one_line(checkpoint, monkeypatch, tmp_path, refused):
    algorithm = load(checkpoint)
    run = Run.create(tmp_path / "run", algorithm.trained_with)
    run.save(algorithm, "final/policy")
    before = {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()}
    monkeypatch.setattr(os, "fsync", no_space)
    message = refused(run.save, algorithm, "final/policy")
    assert message == f"cannot write {run.folder / 'final' / 'policy.safetensors'}: No space left on device"
    assert {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()} == before
