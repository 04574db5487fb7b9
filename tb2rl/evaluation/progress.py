"""Progress bars for what takes more than a few seconds: on a terminal only, and gone once the work is done."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, TypeVar

from tqdm import tqdm  # type: ignore[import-untyped]

T = TypeVar("T")


class _Bar(tqdm):
    """A bar whose clock begins with the first thing that is done, because that one may wait for a compilation."""

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and not self.n:
            self.start_t, self.initial = self._time(), n
        return super().update(n)


def progress(things: Iterable[T] | None, what: str, unit: str, total: int | None = None, shown: bool = True) -> tqdm[T]:
    """A bar that advances with each of the things that are taken from it.

    Args:
        things: What to go through; None: the caller tells the bar with `update`.
        what: Stands before the bar, for example "evaluating".
        unit: What is counted, for example "episode".
        total: How many things there are, where `things` does not know its length.
        shown: False draws no bar, on a terminal either.

    Returns:
        The bar: an iterable over `things`, and a context manager that removes it.
    """
    hidden = None if shown else True  # None: tqdm hides the bar where stderr is not a terminal
    options = {
        "desc": what,
        "unit": f" {unit}",
        "total": total,
        "smoothing": 0,
    }  # 0: the mean rate, as things come in lots
    return _Bar(things, **options, file=sys.stderr, leave=False, disable=hidden)


def say(line: Any) -> None:
    """Print a line to stdout, above the bars that are drawn at the moment."""
    tqdm.write(str(line), file=sys.stdout)
    sys.stdout.flush()
