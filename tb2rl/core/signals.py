"""Signals that ask a program to end: Ctrl-C, `kill`, a closed terminal."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows: two


@contextmanager
def ending_signals(handler: Callable[[int], None]) -> Iterator[None]:
    """Call `handler` with the number of each such signal during the block.

    An ignored hangup stays ignored, as `nohup` arranges. Does nothing outside the main thread, which receives signals.
    """

    def handle(number: int, _frame: object) -> None:
        _drop_lost_terminal()
        handler(number)

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, handle)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def end_program(number: int) -> NoReturn:
    """End this program like the signal does, but run its `finally` blocks: a handler for `ending_signals`.

    Raises:
        KeyboardInterrupt: At Ctrl-C.
        SystemExit: At another signal, with the status that a shell reports for it.
    """
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def ignore_ending_signals() -> None:
    """Ignore such signals in a helper process, because its parent receives them too and decides."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def _drop_lost_terminal() -> None:
    """Redirect stdout and stderr to nowhere if their terminal is gone, because writing would raise an OSError."""
    for stream in (1, 2):
        try:
            os.write(stream, b"")
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
