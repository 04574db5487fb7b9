"""Numba's `njit` with a more robust cache, which all compiled functions of tb2rl use.

Numba caches in the first writable folder of NUMBA_CACHE_DIR, `__pycache__` beside the source, and the user's cache.
This module solves three problems:

- If no folder is writable, numba raises an error. Here, a temporary folder is used.
- Numba does not read caches in read-only folders, such as those of a container image. Here, they are copied.
- Numba does not notice changes in called functions. Here, caches older than the newest file with an `njit` are removed.
"""

import atexit
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import event
from numba.core.options import DefaultOptions

from tb2rl.core.files import atomic_write

# Option for compiled loops that create no arrays. It disables reference counting, because threads wait for each other
# at the counters. The option is private in numba; if it is missing, the loops are only slower.
NO_REFCOUNT: dict[str, Any] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}

_configured_cache_dir = numba.config.CACHE_DIR  # NUMBA_CACHE_DIR, before `_use_temporary_folder` changes it
_source_times: dict[str, float] = {}  # modification times [s] of the files with decorated functions


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Like `numba.njit`, but caches in a temporary folder, or not at all, if numba finds no writable folder.

    Set `error_model`, `fastmath` and `forceinline` explicitly where speed matters. Otherwise a function inherits them
    from its first caller, and the cache keeps them.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        file = Path(function.__code__.co_filename)
        with suppress(OSError):  # a cell of a notebook has no file
            _source_times[str(file)] = file.stat().st_mtime
        with suppress(RuntimeError):  # numba finds no writable folder
            return _decorate_with_cache(function, file, options)
        with suppress(RuntimeError, OSError):
            _use_temporary_folder()
            return _decorate_with_cache(function, file, options)
        _warn("compiled code is lost when this program ends, and the next program compiles again")
        return numba.njit(**{**options, "cache": False})(function)

    return decorate


def announce_compiling() -> None:
    """Print a line on stderr before the first compilation, if stderr is a terminal."""
    if sys.stderr is not None and sys.stderr.isatty():
        event.register("numba:compile", _Announcement())


class _Announcement(event.Listener):
    """Listener for numba's compilation events, which do not occur for cached functions."""

    is_printed = False

    def on_start(self, _: event.Event) -> None:
        if not self.is_printed:
            print("compiling the simulator, once: about 20 s", file=sys.stderr, flush=True)
        self.is_printed = True

    def on_end(self, _: event.Event) -> None:
        pass


def _decorate_with_cache(function: Callable[..., Any], file: Path, options: dict[str, Any]) -> Any:
    dispatcher = numba.njit(**options)(function)
    folder, pattern = Path(dispatcher.stats.cache_path), f"{file.stem}.*.nbi"
    newest_source_time = max(_source_times.values(), default=0.0)
    for index_file in folder.glob(pattern):
        with suppress(FileNotFoundError):  # another process has removed the file
            if index_file.stat().st_mtime < newest_source_time:
                index_file.unlink()
    # Numba names its subfolders of NUMBA_CACHE_DIR after the folder of the source and a hash.
    configured_folders = Path(_configured_cache_dir).glob(f"{file.parent.name}_*") if _configured_cache_dir else ()
    other_folders = [other for other in (file.parent / "__pycache__", *configured_folders) if other != folder]
    for index_file in [path for other in other_folders for path in other.glob(pattern)]:
        with suppress(OSError):
            if index_file.stat().st_mtime >= newest_source_time and not (folder / index_file.name).exists():
                # The index file is copied last, because numba reads the other files only if the index file exists.
                for cache_file in (*index_file.parent.glob(f"{index_file.stem}.*.nbc"), index_file):
                    with atomic_write(folder / cache_file.name) as temporary:
                        shutil.copyfile(cache_file, temporary)
    if _use_temporary_folder.cache_info().currsize and not any(folder.glob(pattern)):  # temporary and without a copy
        _warn("compiled code is kept only until this program ends")
    return dispatcher


@cache
def _use_temporary_folder() -> None:
    """Set NUMBA_CACHE_DIR, also for child processes, to a new folder that is removed at exit."""
    folder = tempfile.mkdtemp(prefix="tb2rl-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = folder


@cache
def _warn(problem: str) -> None:
    message = f"tb2rl: {problem}; set the variable NUMBA_CACHE_DIR to a writable folder"
    warnings.warn(message, RuntimeWarning, stacklevel=2)
