"""Progress bars, shown on a terminal only, and removed at the end."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, TypeVar

from tqdm import tqdm  # type: ignore[import-untyped]

T = TypeVar("T")


class _Bar(tqdm):
    """A bar whose clock starts after the first item, because the first item may wait for a compilation."""

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and not self.n:
            self.start_t, self.initial = self._time(), n
        return super().update(n)


def progress(items: Iterable[T] | None, title: str, unit: str, total: int | None = None, shown: bool = True) -> tqdm[T]:
    """A progress bar over items.

    Args:
        items: The items; None: the caller advances the bar with `update`.
        title: Text before the bar, for example "evaluating".
        unit: Name of an item, for example "episode".
        total: Number of items; needed if `items` has no length.
        shown: Whether to show the bar if stderr is a terminal.

    Returns:
        The bar, an iterable over `items` and a context manager that removes the bar.
    """
    disable = None if shown else True  # None: tqdm hides the bar if stderr is not a terminal
    options: dict[str, Any] = {"unit": f" {unit}", "leave": False, "file": sys.stderr, "disable": disable}
    return _Bar(items, title, total, smoothing=0, **options)  # 0: estimate by the mean rate, as items come in blocks


def say(line: Any) -> None:
    """Print a line to stdout, above the progress bars."""
    tqdm.write(str(line), file=sys.stdout)
    sys.stdout.flush()
