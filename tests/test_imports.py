"""`import tb2rl`, names of plugins and every `--help` import nothing heavy."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tb2rl.__main__ import COMMANDS

HEAVY = (
    "torch", "numba", "stable_baselines3", "pybullet", "tensorboard", "pydantic", "shapely", "matplotlib", "optuna",
)  # fmt: skip
SHOWN = f"print('heavy:', *[name for name in {HEAVY} if name in sys.modules])"
HELP = f"""
import sys
from importlib import import_module
for name in {["tb2rl.__main__", *COMMANDS.values()]}:
    try:
        import_module(name).main(['--help'])
    except SystemExit:
        pass
"""
NAMES = """
import sys, tb2rl
from tb2rl.core.plugins import agent_names, robot_names, simulator_names, task_names
agent_names(), robot_names(), simulator_names(), task_names()
assert {*tb2rl.__all__, '__version__'} <= {*dir(tb2rl)} and tb2rl.__version__
"""


def last_line(code: str) -> str:
    """The last line that a new Python prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize("code", [HELP, NAMES], ids=["help", "names"])
def test_nothing_heavy_is_imported(code):
    assert last_line(code + SHOWN) == "heavy:"


@pytest.mark.parametrize("first", ["import tb2rl, gymnasium", "import gymnasium, tb2rl"])
def test_gymnasium_knows_the_ids_in_either_order_of_imports(first):
    ids = "[id for id in gymnasium.registry if 'TurtleBot2' in id]"
    code = f"{first}; print(len({ids}), gymnasium.spec('TurtleBot2Maze-v0').kwargs)"
    assert last_line(code) == "10 {'task': 'maze'}"


@pytest.mark.slow
def test_the_functions_of_the_package_are_functions_whatever_was_imported_before():
    shown = "print([name for name in tb2rl.__all__ if not callable(getattr(tb2rl, name))])"
    assert last_line(f"import tb2rl.train, tb2rl.evaluate; {shown}") == "[]"
