"""Numba's `njit` with a cache wherever there can be one: every module that compiles imports it from here.

Numba keeps what it compiles in the first folder that it may write to: NUMBA_CACHE_DIR, `__pycache__` beside the source,
the user's cache. Where there is none, it refuses to compile, and it reads no folder that it may not write to, such as
those in the image of a container. So here a private folder stands in where there is none, and what was compiled earlier
is copied to where numba reads. Numba also holds a cache against the function's own file alone, though what it calls is
compiled into it: here a cache must be younger than all files whose functions it may call.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
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
from numba.core.caching import _CacheLocator
from numba.core.options import DefaultOptions

# For functions of a loop over robots, which make no array: numba else counts who uses each array, in every call, and
# threads wait for each other at these counts. The option is not documented: where there is none, they are slower.
UNCOUNTED: dict[str, Any] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}

_VARIABLE = "TB2RL_PRIVATE_CACHE"  # tells processes that this one starts where its private folder is; "": there is none
_inherited = os.environ.get(_VARIABLE)
_lock = threading.Lock()
_sources: dict[str, float] = {}  # files that have compiled so far, and when each was changed [s]


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit(cache=True, ...)` that also works where nothing can be written: then without a cache.

    A function without `error_model`, `fastmath` or `forceinline` gets that of the one whose call compiles it first, and
    keeps it in the cache: where speed matters, name them, or it depends on what happened to run first.
    """

    def decorated(function: Callable[..., Any]) -> Any:
        file = function.__code__.co_filename
        with suppress(OSError):  # a notebook's cell is no file
            _sources[file] = Path(file).stat().st_mtime
        earlier = _earlier_folders(function)
        with suppress(RuntimeError):  # numba may write to no folder
            return _with_cache(function, options, earlier)
        private = _private_folder()
        if private is not None:
            with suppress(RuntimeError, OSError), _caching_in(private):
                return _with_cache(function, options, earlier, warn=True)
        _warn("compiled code is lost when this program ends, and compiled again by the next one")
        return numba.njit(**{**options, "cache": False})(function)

    return decorated


def announce_compiling() -> None:
    """Print a line on stderr, if that is a terminal, before this process compiles the first function."""
    if sys.stderr is not None and sys.stderr.isatty():
        event.register("numba:compile", _Announcement())


class _Announcement(event.Listener):
    """Receives numba's event of a compilation, which there is only if no cache has the code."""

    said = False

    def on_start(self, _: event.Event) -> None:
        if not self.said:
            print("compiling the simulator, once: about 20 s", file=sys.stderr, flush=True)
        self.said = True

    def on_end(self, _: event.Event) -> None:
        pass


def _with_cache(function: Callable[..., Any], options: dict[str, Any], earlier: list[Path], warn: bool = False) -> Any:
    compiled = numba.njit(**options)(function)
    folder, name = Path(compiled.stats.cache_path), f"{Path(function.__code__.co_filename).stem}.*.nbi"
    for index in folder.glob(name):
        with suppress(FileNotFoundError):  # another process may be doing the same
            if _is_stale(index):
                index.unlink()
    for place in earlier:
        if place != folder:
            with suppress(OSError):
                _take_over(place, folder, name)
    if warn and not any(folder.glob(name)):
        _warn("compiled code is kept only until this program ends")
    return compiled


def _earlier_folders(function: Callable[..., Any]) -> list[Path]:
    """Where numba may have kept what it compiled of a function, when these folders could still be written."""
    file = function.__code__.co_filename
    beside = Path(file).parent / "__pycache__"
    named = numba.config.CACHE_DIR
    return [beside, *([Path(named, _CacheLocator.get_suitable_cache_subpath(file))] if named else [])]


def _is_stale(index: Path) -> bool:
    """Whether a file was changed later whose functions are compiled before: what a function calls is among them."""
    return index.stat().st_mtime < max(_sources.values(), default=0.0)


def _take_over(place: Path, folder: Path, name: str) -> None:
    """Copy the caches in `place` whose index is called so to `folder`, but for those that it has.

    The index comes last: while it is missing, nobody reads the other files. Numba itself holds it against the source.
    """
    for index in place.glob(name):
        if not (folder / index.name).exists() and not _is_stale(index):
            for file in (*place.glob(f"{index.stem}.*.nbc"), index):
                temporary = folder / f"{file.name}.{os.getpid()}"
                shutil.copyfile(file, temporary)
                temporary.replace(folder / file.name)


@contextmanager
def _caching_in(folder: str) -> Iterator[None]:
    """Let numba look there first during the block alone: the program that imports us may compile, too."""
    with _lock:
        named, numba.config.CACHE_DIR = numba.config.CACHE_DIR, folder
        try:
            yield
        finally:
            numba.config.CACHE_DIR = named


@cache
def _private_folder() -> str | None:
    """A folder that this process and those that it starts share, removed when it ends; None: there can be none.

    Numba unpickles what it finds, so nobody else may write to it.
    """
    if _inherited == "" or (_inherited and _is_private(_inherited)):
        return _inherited or None
    try:
        folder = tempfile.mkdtemp(prefix="tb2rl-")
        atexit.register(_remove, folder, os.getpid())
    except OSError:
        folder = ""
    os.environ[_VARIABLE] = folder
    return folder or None


def _is_private(folder: str) -> bool:
    """Whether it is a folder of this user, whom Windows gives folders of their own anyway, and no one else's."""
    try:
        found = os.lstat(folder)
    except OSError:
        return False
    mine = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o077)
    return stat.S_ISDIR(found.st_mode) and mine


def _remove(folder: str, maker: int) -> None:
    if os.getpid() == maker:  # and not a fork of it
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _warn(what: str) -> None:
    if _inherited is None:  # else the process that started this one has said so
        line = f"tb2rl: {what}; set the variable NUMBA_CACHE_DIR to a folder that can be written"
        warnings.warn(line, RuntimeWarning, stacklevel=2)
