"""Reinforcement learning for a TurtleBot2. Example::

    import tb2rl
    policy = tb2rl.load("runs/maze/dqn/NAME")
    env = tb2rl.make_env(policy)

Importing the package registers the Gymnasium ids. PyTorch and the simulators are imported at first use.
"""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import gymnasium

# In a checkout agents/, configs/ and zoo/ are beside this package; in an installation they are inside.
if (Path(__file__).parent.parent / "pyproject.toml").is_file():
    __path__.append(str(Path(__file__).parent.parent))

if TYPE_CHECKING:
    from tb2rl.core.agent import Agent
    from tb2rl.core.errors import InputError
    from tb2rl.envs.make import make_env
    from tb2rl.evaluation.evaluate import evaluate
    from tb2rl.runs.loading import load
    from tb2rl.training.training import train
    from tb2rl.viz.viewer.environment import view

    __version__: str

__all__ = ["Agent", "InputError", "evaluate", "load", "make_env", "train", "view"]

_TASKS = {
    "TurtleBot2Maze": "maze",
    "MyTurtleBot2Maze": "my-maze",
    "TurtleBot2Wall": "wall",
    "TurtleBot2Drive": "drive",
    "TurtleBot2Navigate": "navigate",
}
GYM_IDS = {f"{name}-v0": {"task": task} for name, task in _TASKS.items()}
# Ids for programs that want raw observations, but cannot pass observation="raw" to `gymnasium.make`.
GYM_IDS |= {f"{name}Raw-v0": {"task": task, "observation": "raw"} for name, task in _TASKS.items()}
for _id, _arguments in GYM_IDS.items():
    gymnasium.register(
        _id,
        entry_point="tb2rl.envs.make:make_for_gymnasium",
        vector_entry_point="tb2rl.envs.make:make_vector_for_gymnasium",
        kwargs=_arguments,
    )

_MODULES = {  # the module that defines each public name
    "Agent": "core.agent",
    "InputError": "core.errors",
    "evaluate": "evaluation.evaluate",
    "load": "runs.loading",
    "make_env": "envs.make",
    "train": "training.training",
    "view": "viz.viewer.environment",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib import metadata  # imported late, because it takes a fifth of the import time of the package

        try:
            return metadata.version("tb2rl")
        except metadata.PackageNotFoundError:  # a checkout that is not installed
            return "0+unknown"
    if name not in _MODULES:
        raise AttributeError(f"module 'tb2rl' has no attribute {name!r}")
    return getattr(import_module(f"tb2rl.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})


class _Package(ModuleType):
    """Keeps the functions `tb2rl.train` and `tb2rl.evaluate` when the modules of the same names are imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _MODULES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
