"""Numba's `njit` with a cache wherever there can be one: every module that compiles imports it from here.

Numba caches in the first writable folder of NUMBA_CACHE_DIR, `__pycache__` beside the source, and the user's cache.
Where none is writable it refuses to compile, and it never reads a folder without write permission, such as those of a
container image. Here a private temporary folder stands in, and earlier caches are copied to where numba reads. Numba
compares a cache with the function's own file only, although callees are compiled into it: here a cache must be younger
than all files whose functions it may call.
"""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import event
from numba.core.options import DefaultOptions

# For loops over environments that create no array: otherwise numba counts references to every array in every call, and
# threads wait for each other at these counters. No public option does this; without the private one they are slower.
UNCOUNTED: dict[str, Any] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}

_VARIABLE = "TB2RL_PRIVATE_CACHE"  # tells child processes the private folder; "": there is none
_inherited = os.environ.get(_VARIABLE)
_lock = threading.Lock()
_sources: dict[str, float] = {}  # modification times [s] of the files with functions decorated so far


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit(cache=True, ...)` that compiles without a cache where nothing can be written.

    A function without `error_model`, `fastmath` or `forceinline` inherits those of the first caller, and keeps them in
    the cache: name them where speed matters, or it depends on what ran first.
    """

    def decorated(function: Callable[..., Any]) -> Any:
        file = Path(function.__code__.co_filename)
        with suppress(OSError):  # a notebook's cell is no file
            _sources[str(file)] = file.stat().st_mtime
        named = numba.config.CACHE_DIR
        readable = [file.parent / "__pycache__", *(Path(named).glob(f"{file.parent.name}_*") if named else ())]
        with suppress(RuntimeError):  # numba finds no writable folder
            return _with_cache(function, options, readable)
        private = _private_folder()
        if private is not None:
            with suppress(RuntimeError, OSError), _caching_in(private):
                return _with_cache(function, options, readable, warn=True)
        _warn("compiled code is lost when this program ends, and compiled again by the next one")
        return numba.njit(**{**options, "cache": False})(function)

    return decorated


def announce_compiling() -> None:
    """Print a line on stderr, if that is a terminal, before this process compiles the first function."""
    if sys.stderr is not None and sys.stderr.isatty():
        event.register("numba:compile", _Announcement())


class _Announcement(event.Listener):
    """Listener of numba's compilation events, which only occur if no cache has the code."""

    printed = False

    def on_start(self, _: event.Event) -> None:
        if not self.printed:
            print("compiling the simulator, once: about 20 s", file=sys.stderr, flush=True)
        self.printed = True

    def on_end(self, _: event.Event) -> None:
        pass


def _with_cache(function: Callable[..., Any], options: dict[str, Any], readable: list[Path], warn: bool = False) -> Any:
    compiled = numba.njit(**options)(function)
    folder, name = Path(compiled.stats.cache_path), f"{Path(function.__code__.co_filename).stem}.*.nbi"
    for index in folder.glob(name):
        with suppress(FileNotFoundError):  # another process may be doing the same
            if _is_stale(index):
                index.unlink()
    for place in readable:
        if place != folder:
            with suppress(OSError):
                _copy_caches(place, folder, name)
    if warn and not any(folder.glob(name)):
        _warn("compiled code is kept only until this program ends")
    return compiled


def _is_stale(index: Path) -> bool:
    """Whether a file with functions that may be compiled into a cache is younger than its index."""
    return index.stat().st_mtime < max(_sources.values(), default=0.0)


def _copy_caches(place: Path, folder: Path, name: str) -> None:
    """Copy the caches of a module to `folder`; numba itself compares them with the source.

    The index is copied last, because nobody reads the other files while it is missing.
    """
    for index in place.glob(name):
        if not (folder / index.name).exists() and not _is_stale(index):
            for file in (*place.glob(f"{index.stem}.*.nbc"), index):
                temporary = folder / f"{file.name}.{os.getpid()}"
                shutil.copyfile(file, temporary)
                temporary.replace(folder / file.name)


@contextmanager
def _caching_in(folder: str) -> Iterator[None]:
    """Set numba's cache folder during the block only, because the importing program may compile, too."""
    with _lock:
        named, numba.config.CACHE_DIR = numba.config.CACHE_DIR, folder
        try:
            yield
        finally:
            numba.config.CACHE_DIR = named


@cache
def _private_folder() -> str | None:
    """A folder of this user alone, shared with child processes and removed at exit; None if there can be none."""
    if _inherited is not None:
        return _inherited or None
    try:
        folder = tempfile.mkdtemp(prefix="tb2rl-")
        atexit.register(_remove, folder, os.getpid())
    except OSError:
        folder = ""
    os.environ[_VARIABLE] = folder
    return folder or None


def _remove(folder: str, maker: int) -> None:
    if os.getpid() == maker:  # and not a fork of it
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _warn(what: str) -> None:
    if _inherited is None:  # else the parent process has warned
        line = f"tb2rl: {what}; set the variable NUMBA_CACHE_DIR to a folder that can be written"
        warnings.warn(line, RuntimeWarning, stacklevel=2)
