"""PyBullet without the lines that its C code prints; every module that needs pybullet imports it from here."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
    """Keep from the user what PyBullet's C code prints during the block: its build time, its solver."""
    streams = {1: sys.stdout, 2: sys.stderr}
    originals = {descriptor: os.dup(descriptor) for descriptor in streams}
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for descriptor, stream in streams.items():
            stream.flush()
            os.dup2(nowhere, descriptor)
        yield
    finally:
        if sys.platform != "win32":
            ctypes.CDLL(None).fflush(None)  # C's own buffers
        for descriptor, original in originals.items():
            os.dup2(original, descriptor)
            os.close(original)
        os.close(nowhere)


with quiet():
    import pybullet

__all__ = ["pybullet", "quiet"]
