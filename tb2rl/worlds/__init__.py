"""What stands where: the world that a robot is in, the files that worlds are read from, and the geometry of both.

A new file format is a function from a path to a `World` (see README.md). Imported from here: robots, and what all need.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
    from tb2rl.worlds.formats.imports import Import
    from tb2rl.worlds.world import World

__all__ = ["DynamicObstacles", "Import", "World"]

_HOMES = {"Import": "formats.imports", "DynamicObstacles": "dynamic_obstacles", "World": "world"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tb2rl.worlds' has no attribute {name!r}")
    # Only now: the help of `python -m tb2rl.worlds` needs nothing of it.
    return getattr(import_module(f"tb2rl.worlds.{_HOMES[name]}"), name)
