"""tb2rl: a TurtleBot2 that learns its maze.

    import tb2rl
    policy = tb2rl.load("runs/maze/dqn/NAME")
    env = tb2rl.make_env(policy)

Importing this registers the Gymnasium ids; nothing heavy is imported before it is used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import gymnasium

# In a checkout, agents/, configs/ and zoo/ stand beside this package; installed, they are inside it.
if (Path(__file__).parent.parent / "pyproject.toml").is_file():
    __path__.append(str(Path(__file__).parent.parent))

if TYPE_CHECKING:
    from tb2rl.core.agent import Agent
    from tb2rl.core.errors import InputError
    from tb2rl.envs.make import make_env
    from tb2rl.evaluation.evaluate import evaluate
    from tb2rl.runs.loading import load
    from tb2rl.training.training import train

    __version__: str

__all__ = ["Agent", "InputError", "evaluate", "load", "make_env", "train"]

GYM_IDS = {
    "TurtleBot2Maze-v0": {"task": "maze"},
    "MyTurtleBot2Maze-v0": {"task": "my-maze"},
    "TurtleBot2Wall-v0": {"task": "wall"},
    "TurtleBot2Drive-v0": {"task": "drive"},
    "TurtleBot2Navigate-v0": {"task": "navigate"},
    # With raw observations, for programs that can name an environment and pass it no arguments.
    "TurtleBot2MazeRaw-v0": {"task": "maze", "observation": "raw"},
    "MyTurtleBot2MazeRaw-v0": {"task": "my-maze", "observation": "raw"},
    "TurtleBot2WallRaw-v0": {"task": "wall", "observation": "raw"},
    "TurtleBot2DriveRaw-v0": {"task": "drive", "observation": "raw"},
    "TurtleBot2NavigateRaw-v0": {"task": "navigate", "observation": "raw"},
}
for _id, _arguments in GYM_IDS.items():
    gymnasium.register(
        _id,
        entry_point="tb2rl.envs.make:make_for_gymnasium",
        vector_entry_point="tb2rl.envs.make:make_vector_for_gymnasium",
        kwargs=_arguments,
    )

_HOMES = {
    "Agent": "core.agent",
    "InputError": "core.errors",
    "evaluate": "evaluation.evaluate",
    "load": "runs.loading",
    "make_env": "envs.make",
    "train": "training.training",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name not in _HOMES:
        raise AttributeError(f"module 'tb2rl' has no attribute {name!r}")
    return getattr(import_module(f"tb2rl.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version  # a fifth of the time that the package takes

    try:
        return version("tb2rl")
    except PackageNotFoundError:  # a checkout that is not installed
        return "0+unknown"


class _Package(ModuleType):
    """Keeps `tb2rl.train` and `tb2rl.evaluate` the functions when the commands' modules of these names are imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
