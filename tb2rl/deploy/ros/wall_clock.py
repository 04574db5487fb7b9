"""Wall-clock time, as a dependency that tests replace by simulated time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class WallClock:
    """Reads the time, waits, and repeats calls in a thread."""

    def now(self) -> float:
        """Return a monotonic time [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def wait(self, condition: threading.Condition | threading.Event, seconds: float) -> bool:
        """Wait for a notification; False: there was none in time."""
        return condition.wait(seconds)

    def repeat(self, seconds: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call a function periodically in a thread; return the function that ends the thread."""
        ended = threading.Event()

        def call() -> None:
            while not ended.wait(seconds):
                callback()

        thread = threading.Thread(target=call, daemon=True)
        thread.start()

        def end() -> None:
            ended.set()
            thread.join()

        return end
