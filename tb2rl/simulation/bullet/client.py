"""Imports pybullet without the output of its C code; every module that needs pybullet imports it from here."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

_STREAMS = {"linux": ("stdout", "stderr"), "darwin": ("__stdoutp", "__stderrp")}  # their names in C libraries
_lock = threading.RLock()


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output of PyBullet's C code during the block: its build time, its solver.

    Only the streams of C are redirected, not the descriptors, so that output of Python passes, from any thread. On
    other systems than Linux and macOS the lines show.
    """
    with _lock:
        streams = _streams_of_c()
        originals = [stream.value for stream in streams]
        try:
            for stream in streams:
                stream.value = _null_stream()
            yield
        finally:
            for stream, original in zip(streams, originals, strict=True):
                stream.value = original


@cache
def _streams_of_c() -> list[ctypes.c_void_p]:
    """The variables of the C library that hold standard output and standard error."""
    try:
        return [ctypes.c_void_p.in_dll(ctypes.CDLL(None), name) for name in _STREAMS[sys.platform]]
    except (KeyError, ValueError):
        return []


@cache
def _null_stream() -> int:
    """A stream of C to the null device; it stays open, because another thread may be printing to it."""
    library = ctypes.CDLL(None)
    library.fopen.restype, library.fopen.argtypes = ctypes.c_void_p, (ctypes.c_char_p, ctypes.c_char_p)
    return library.fopen(os.devnull.encode(), b"w")


with quiet():
    import pybullet

__all__ = ["pybullet", "quiet"]
