"""The signals that end a program that drives a robot: none of them may leave the robot driving."""

from __future__ import annotations

import signal
from typing import Any, Callable, Dict, List

_ENDINGS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")  # no system has all of them


class SignalledError(Exception):
    """A signal came.

    Attributes:
        status: The exit status as shells count it.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


class Ending:
    """Raises a `SignalledError` at a signal, but only while the program waits: a line that it has begun it ends.

    with Ending() as ending:
        line = ending.wait_for(read)
    """

    def __enter__(self) -> Ending:
        self._number, self._waits = 0, False
        self._before: Dict[Any, Any] = {sign: signal.signal(sign, self._end) for sign in ending_signals()}
        return self

    def __exit__(self, *_: Any) -> None:
        for sign, handler in self._before.items():
            signal.signal(sign, handler)

    def wait_for(self, read: Callable[[], Any]) -> Any:
        """Call a function that may take for ever, and return its result.

        Raises:
            SignalledError: At a signal, also at one that came before.
        """
        self._waits = True
        try:
            if self._number:
                raise SignalledError(self._number)
            return read()
        finally:
            self._waits = False

    def _end(self, number: int, frame: Any) -> None:
        self._number = self._number or number
        if self._waits:
            self._waits = False  # only the first one raises
            raise SignalledError(self._number)


def ending_signals() -> List[signal.Signals]:
    """Those of this system, except for a hangup that is ignored, as by `nohup`."""
    signals = [getattr(signal, name) for name in _ENDINGS if hasattr(signal, name)]
    return [sign for sign in signals if sign.name != "SIGHUP" or signal.getsignal(sign) != signal.SIG_IGN]
