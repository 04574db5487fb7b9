"""The live table of the jobs that run: on a terminal only, and gone once all are done."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.table import Table

_ROWS = 20  # of jobs that run; more are counted


class LiveTable:
    """Shows which jobs run, for how long, and how many are done.

    Args:
        total: How many there are; None: nobody knows yet.
    """

    def __init__(self, total: int | None = None) -> None:
        self._total, self._done = total, 0
        self._began: dict[str, float] = {}
        console = Console(stderr=True)
        self._live = Live(get_renderable=self._table, console=console, transient=True) if sys.stderr.isatty() else None

    def begin(self, name: str) -> None:
        """A job runs from now on."""
        self._began[name] = time.monotonic()

    def end(self, name: str) -> float:
        """A job is done; for how many seconds it ran, the waiting for a place in a cluster included."""
        self._done += 1
        return time.monotonic() - self._began.pop(name)

    def _table(self) -> Table:
        table = Table("running", "for", caption=self._caption(), box=None)
        for name, began in list(self._began.items())[:_ROWS]:
            table.add_row(name, f"{time.monotonic() - began:.0f} s")
        if len(self._began) > _ROWS:
            table.add_row(f"and {len(self._began) - _ROWS} more", "")
        return table

    def _caption(self) -> str:
        return f"{self._done} done" if self._total is None else f"{self._done} of {self._total} done"

    def __enter__(self) -> LiveTable:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, _type: type[BaseException] | None, _error: object, _trace: TracebackType | None) -> None:
        if self._live:
            self._live.stop()
