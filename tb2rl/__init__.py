"""tb2rl: a TurtleBot2 that learns its maze.

    import tb2rl
    policy = tb2rl.load("runs/maze/dqn/NAME")
    env = tb2rl.make_env(policy)

Importing this registers the Gymnasium ids; nothing heavy is imported before it is used.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

# In a checkout, agents/, configs/ and zoo/ stand beside this package; installed, they are inside it.
if (Path(__file__).parent.parent / "pyproject.toml").is_file():
    __path__.append(str(Path(__file__).parent.parent))

if TYPE_CHECKING:
    from tb2rl.envs import make_env
    from tb2rl.errors import InputError
    from tb2rl.evaluate import evaluate
    from tb2rl.runs import load
    from tb2rl.train import train

__all__ = ["InputError", "evaluate", "load", "make_env", "train"]

try:
    __version__ = version("tb2rl")
except PackageNotFoundError:  # a checkout that is not installed
    __version__ = "0+unknown"

GYM_IDS = {"TurtleBot2Maze-v0": "maze", "MyTurtleBot2Maze-v0": "my-maze", "TurtleBot2Wall-v0": "wall"}
for _id, _task in GYM_IDS.items():
    gymnasium.register(_id, entry_point="tb2rl.envs:TurtleBot2Env", kwargs={"task": _task})

_HOMES = {"InputError": "errors", "evaluate": "evaluate", "load": "runs", "make_env": "envs", "train": "train"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tb2rl' has no attribute {name!r}")
    value = getattr(import_module(f"tb2rl.{_HOMES[name]}"), name)
    globals()[name] = value  # over the submodule of the same name, which the import put there
    return value
