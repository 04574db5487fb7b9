"""Worlds: obstacles, start and goal; the files that they are read from, and their geometry.

A new file format is a function from a path to a `World` (see README.md). Imports `robots` and `core`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
    from tb2rl.worlds.formats.imports import ImportOptions
    from tb2rl.worlds.world import World

__all__ = ["DynamicObstacles", "ImportOptions", "World"]

_HOMES = {"DynamicObstacles": "dynamic_obstacles", "ImportOptions": "formats.imports", "World": "world"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tb2rl.worlds' has no attribute {name!r}")
    # Imported late, because the help of `python -m tb2rl.worlds` needs none of them.
    return getattr(import_module(f"tb2rl.worlds.{_HOMES[name]}"), name)
