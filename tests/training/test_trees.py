"""What of a training is saved, and how it is held against what is there when it comes back."""

from __future__ import annotations

from collections import deque, namedtuple
from typing import Any

import numpy as np
import pytest
import torch as th

from tb2rl.training.trees import fill, is_value

Pair = namedtuple("Pair", "one other")


def kind(value: Any) -> str:
    return type(value).__name__


@pytest.mark.parametrize(
    "value",
    [True, 3, 0.5, np.zeros(2), np.float32(1.0), th.ones(1), deque(), (1, 2.0), (np.ones(1), (1,)), {"a": np.ones(1)}],
    ids=kind,
)
def test_numbers_arrays_and_what_holds_them_are_saved(value):
    assert is_value(value)


@pytest.mark.parametrize("value", [None, "x", [1], [], (), {}, (1, "x"), {"a": object()}, len, object()], ids=kind)
def test_other_things_are_not(value):
    assert not is_value(value)


@pytest.mark.parametrize(
    ("example", "value", "made"),
    [
        (1, 2, 2),
        (0.5, 2, 2),
        (0.5, 0.25, 0.25),
        (True, False, False),
        (np.float32(0.5), 2.0, 2.0),
        (np.int64(1), 2, 2),
        ((1, 2.0), [3, 4], (3, 4)),
        ([1, [2]], [3, [4]], [3, [4]]),
        (Pair(1, 2), [3, 4], Pair(3, 4)),
        ({"a": {"b": 1}}, {"a": {"b": 2}}, {"a": {"b": 2}}),
    ],
    ids=kind,
)
def test_a_value_takes_the_form_of_the_example(example, value, made):
    found = fill(example, value, "it")
    assert found == made
    assert type(found) is type(made)


def test_a_queue_keeps_its_length():
    found = fill(deque([1], maxlen=2), [3, 4, 5], "it")
    assert (list(found), found.maxlen) == ([4, 5], 2)


def test_an_array_is_written_into_the_one_that_is_there():
    """A convolution rounds otherwise for an image that lies otherwise in memory."""
    there = np.zeros((2, 3), order="F")
    given = np.arange(6.0).reshape(2, 3)
    found = fill({"a": there}, {"a": given}, "it")["a"]
    assert found is there
    assert found.flags.f_contiguous
    np.testing.assert_array_equal(found, given)


def test_a_tensor_comes_back_as_one():
    found = fill(th.zeros(2, 3), np.arange(6, dtype=np.float32).reshape(2, 3), "it")
    assert th.equal(found, th.arange(6.0).reshape(2, 3))


ARRAY = np.zeros((2, 3))
STRANGE: list[tuple[Any, Any]] = [
    *((ARRAY, value) for value in (None, 3, [[0.0] * 3] * 2, ARRAY[0], ARRAY[None], ARRAY[:, :2], ARRAY[:0])),
    *((ARRAY, ARRAY.astype(kind)) for kind in (np.float32, np.int64, bool)),
    (th.zeros(2), np.zeros(2)),  # of another type
    (th.zeros(2), np.zeros(3, dtype=np.float32)),
    *((1, value) for value in (1.0, True, "1", None, [1], np.int64(1))),
    *((0.5, value) for value in (float("nan"), float("inf"), True, "1", None)),
    *((True, value) for value in (1, None, "x")),
    *(((1, 2), value) for value in ([1], [1, 2, 3], [1, "x"], {"0": 1}, None)),
    *(({"a": 1}, value) for value in ({}, {"b": 1}, {"a": 1, "b": 2}, {"a": "x"}, [1], None)),
    *((deque([1]), value) for value in (None, 3, {"a": 1})),
]


@pytest.mark.parametrize(("example", "value"), STRANGE, ids=kind)
def test_another_form_is_refused(example, value):
    with pytest.raises(ValueError, match=r"it.* has another form"):
        fill(example, value, "it")
