"""Imports pybullet without the output of its C code; every module that needs pybullet imports it from here."""

import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

_STREAMS = {"linux": ("stdout", "stderr"), "darwin": ("__stdoutp", "__stderrp")}  # variable names in C libraries
_lock = threading.RLock()


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output of PyBullet's C code, such as its build time, on Linux and macOS.

    Only the streams of C are redirected, not the file descriptors, so that Python can still print, from any thread.
    """
    with _lock:
        streams, null = _streams_of_c()
        originals = [stream.value for stream in streams]
        try:
            for stream in streams:
                stream.value = null
            yield
        finally:
            for stream, original in zip(streams, originals, strict=True):
                stream.value = original


@cache
def _streams_of_c() -> tuple[list[ctypes.c_void_p], int]:
    """The C library's variables of standard output and standard error, and a stream to the null device.

    The stream is never closed, because another thread may be printing to it.
    """
    if sys.platform not in _STREAMS:
        return [], 0
    library = ctypes.CDLL(None)
    library.fopen.restype, library.fopen.argtypes = ctypes.c_void_p, (ctypes.c_char_p, ctypes.c_char_p)
    streams = [ctypes.c_void_p.in_dll(library, name) for name in _STREAMS[sys.platform]]
    return streams, library.fopen(os.devnull.encode(), b"w")


with quiet():
    import pybullet

__all__ = ["pybullet", "quiet"]
