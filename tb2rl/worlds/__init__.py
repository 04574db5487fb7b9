"""Worlds: obstacles with a start and a goal, their file formats and their geometry.

A new file format is a function from a path to a `World` (see README.md). Imports `robots` and `core`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
    from tb2rl.worlds.formats.imports import ImportOptions
    from tb2rl.worlds.world import World

__all__ = ["DynamicObstacles", "ImportOptions", "World"]

_MODULES = {"DynamicObstacles": "dynamic_obstacles", "ImportOptions": "formats.imports", "World": "world"}


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'tb2rl.worlds' has no attribute {name!r}")
    # Imported at the first use, because `python -m tb2rl.worlds --help` needs none of these modules.
    return getattr(import_module(f"tb2rl.worlds.{_MODULES[name]}"), name)
