"""The progress table of running jobs: on a terminal only, and removed at the end."""

from __future__ import annotations

import sys
import time

from rich.console import Console
from rich.live import Live
from rich.table import Table

_MAX_ROWS = 20


class LiveTable:
    """Shows which jobs run, for how long, and how many are done.

    Args:
        total: Number of jobs; None: not known.
    """

    def __init__(self, total: int | None = None) -> None:
        self._total, self._done = total, 0
        self._started: dict[str, float] = {}
        console = Console(stderr=True)
        self._live = Live(get_renderable=self._table, console=console, transient=True) if sys.stderr.isatty() else None

    def start(self, name: str) -> None:
        """Add a running job."""
        self._started[name] = time.monotonic()

    def finish(self, name: str) -> None:
        """Remove a job and count it."""
        self._done += 1
        del self._started[name]

    def _table(self) -> Table:
        caption = f"{self._done} done" if self._total is None else f"{self._done} of {self._total} done"
        table = Table("running", "for", caption=caption, box=None)
        for name, started in list(self._started.items())[:_MAX_ROWS]:
            table.add_row(name, f"{time.monotonic() - started:.0f} s")
        if len(self._started) > _MAX_ROWS:
            table.add_row(f"and {len(self._started) - _MAX_ROWS} more", "")
        return table

    def __enter__(self) -> LiveTable:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()
