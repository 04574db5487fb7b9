"""Termination signals, none of which may leave a robot driving."""

from __future__ import annotations

import signal
from typing import Any, Callable

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")  # no system has all of them


def termination_signals() -> list[signal.Signals]:
    """The termination signals of this system, without a SIGHUP that is ignored, as by `nohup`."""
    signals = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    return [each for each in signals if each.name != "SIGHUP" or signal.getsignal(each) != signal.SIG_IGN]


class SignalledError(Exception):
    """A termination signal came; its argument is the number of the signal."""


class SignalGuard:
    """Defers termination signals to `wait_for`, so that the program completes the line that it writes.

    with SignalGuard() as guard:
        line = guard.wait_for(read)
    """

    def __enter__(self) -> SignalGuard:
        self._received, self._waiting = 0, False
        self._previous: dict[Any, Any] = {each: signal.signal(each, self._handle) for each in termination_signals()}
        return self

    def __exit__(self, *_: Any) -> None:
        for each, handler in self._previous.items():
            signal.signal(each, handler)

    def wait_for(self, read: Callable[[], Any]) -> Any:
        """Call a function that may block, and return its result.

        Raises:
            SignalledError: At a signal, also one that came before the call.
        """
        self._waiting = True
        try:
            if self._received:
                raise SignalledError(self._received)
            return read()
        finally:
            self._waiting = False

    def _handle(self, number: int, frame: Any) -> None:
        self._received = self._received or number
        if self._waiting:
            self._waiting = False  # only the first signal raises
            raise SignalledError(self._received)
