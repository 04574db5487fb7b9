"""Termination signals, which must stop a robot before they end the program."""

from __future__ import annotations

import signal
from typing import Any, Callable

_SIGNAL_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")  # no system has all of them


def termination_signals() -> list[signal.Signals]:
    """The termination signals of this system, without SIGHUP if the process ignores it, as under `nohup`."""
    signals = [getattr(signal, name) for name in _SIGNAL_NAMES if hasattr(signal, name)]
    return [each for each in signals if each.name != "SIGHUP" or signal.getsignal(each) != signal.SIG_IGN]


class SignalledError(Exception):
    """A termination signal arrived; the argument is the number of the signal."""


class SignalGuard:
    """Defers termination signals until `wait_for` is called, so that no output line is cut off.

    with SignalGuard() as guard:
        line = guard.wait_for(read)
    """

    def __enter__(self) -> SignalGuard:
        self._signal_number, self._waiting = 0, False
        self._previous: dict[Any, Any] = {each: signal.signal(each, self._handle) for each in termination_signals()}
        return self

    def __exit__(self, *_: Any) -> None:
        for each, handler in self._previous.items():
            signal.signal(each, handler)

    def wait_for(self, read: Callable[[], Any]) -> Any:
        """Call a function that may block; a signal during the call or before it raises `SignalledError`."""
        self._waiting = True
        try:
            if self._signal_number:
                raise SignalledError(self._signal_number)
            return read()
        finally:
            self._waiting = False

    def _handle(self, number: int, frame: Any) -> None:
        self._signal_number = self._signal_number or number
        if self._waiting:
            self._waiting = False  # only the first signal raises
            raise SignalledError(self._signal_number)
