"""Progress bars for work of more than a few seconds: on a terminal only, and removed at the end."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, TypeVar

from tqdm import tqdm  # type: ignore[import-untyped]

T = TypeVar("T")


class _Bar(tqdm):
    """A bar whose clock starts when the first item is done, because that one may wait for a compilation."""

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and not self.n:
            self.start_t, self.initial = self._time(), n
        return super().update(n)


def progress(items: Iterable[T] | None, what: str, unit: str, total: int | None = None, shown: bool = True) -> tqdm[T]:
    """A progress bar over some items.

    Args:
        items: The items; None: the caller advances the bar with `update`.
        what: Text before the bar, for example "evaluating".
        unit: Of the count, for example "episode".
        total: Number of items, if `items` has no length.
        shown: Whether to draw the bar at all.

    Returns:
        The bar: an iterable over `items`, and a context manager that removes it.
    """
    hidden = None if shown else True  # None: tqdm hides the bar where stderr is not a terminal
    options = {"desc": what, "unit": f" {unit}", "total": total}
    options["smoothing"] = 0  # the mean rate, because items come in blocks
    return _Bar(items, **options, file=sys.stderr, leave=False, disable=hidden)


def say(line: Any) -> None:
    """Print a line to stdout, above the present bars."""
    tqdm.write(str(line), file=sys.stdout)
    sys.stdout.flush()
