"""A limit to the memory that strangers' files can take: some lines of a compressed file can mean gigabytes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_STATE = Path("/proc/self/statm")  # Linux: begins with the pages that the process has


@contextmanager
def limited_memory(more: int) -> Iterator[None]:
    """Let the process take so many bytes more at most, and write no larger file: else there is an error in the block.

    The limit is Linux's; on other systems there is none. It holds for all threads of the process.

    Raises:
        MemoryError: If the block takes more.
        OSError: If it writes more into one file.
    """
    if resource is None or not _STATE.exists():
        yield
        return
    taken = int(_STATE.read_text().split()[0]) * resource.getpagesize()
    limits = {resource.RLIMIT_AS: taken + more, resource.RLIMIT_FSIZE: more}
    before = {kind: resource.getrlimit(kind) for kind in limits}
    try:
        for kind, limit in limits.items():
            soft, hard = before[kind]
            resource.setrlimit(kind, (limit if soft == resource.RLIM_INFINITY else min(limit, soft), hard))
        yield
    finally:
        for kind, (soft, hard) in before.items():
            resource.setrlimit(kind, (soft, hard))
