"""Stands in for `tb2rl.core.compiled` on a robot, which may lack numba: compiles nothing."""

from __future__ import annotations

from typing import Any, Callable


def njit(**_: Any) -> Callable[[Any], Any]:
    """Accept numba's options and return the function unchanged."""
    return lambda function: function
