"""Handles termination signals: Ctrl-C, `kill`, a closed terminal."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import NoReturn

# Windows has no SIGHUP.
_TERMINATION_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def handle_termination_signals(handler: Callable[[int], None]) -> Iterator[None]:
    """Call `handler` with the signal number of each termination signal during the block.

    Ignored signals except SIGINT stay ignored, such as SIGHUP under `nohup`. Only the main thread receives signals; in
    other threads, the block runs without a handler.
    """

    def handle(number: int, _frame: object) -> None:
        _discard_output_of_closed_terminal()
        handler(number)

    with ExitStack() as restore:
        if threading.current_thread() is threading.main_thread():
            for number in _TERMINATION_SIGNALS:
                if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                    restore.callback(signal.signal, number, signal.signal(number, handle))
        yield


def exit_by_signal(number: int) -> NoReturn:
    """A handler for `handle_termination_signals` that ends the program, but runs its `finally` blocks.

    Raises:
        KeyboardInterrupt: For SIGINT.
        SystemExit: For other signals, with the status that a shell reports.
    """
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def ignore_termination_signals() -> None:
    """Ignore termination signals in a worker process, because its parent receives and handles them."""
    for number in _TERMINATION_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _discard_output_of_closed_terminal() -> None:
    """Redirect stdout and stderr to the null device if their terminal is closed, because printing would fail."""
    for descriptor in (1, 2):
        try:
            os.write(descriptor, b"")
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
