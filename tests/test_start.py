"""`import tb2rl` and every `--help` import nothing heavy."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tb2rl.__main__ import COMMANDS

HEAVY = (
    "torch", "numba", "stable_baselines3", "pybullet", "tensorboard", "pydantic", "shapely", "matplotlib", "optuna",
)  # fmt: skip
SHOWN = f"print('heavy:', *[name for name in {HEAVY} if name in sys.modules])"


def last_line(code: str) -> str:
    """The last line that a new Python prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1]


def test_every_help_imports_nothing_heavy():
    loop = (
        f"for name in {['tb2rl.__main__', *COMMANDS.values()]}:\n    try:\n        import_module(name).main(['--help'])"
    )
    code = f"import sys\nfrom importlib import import_module\n{loop}\n    except SystemExit:\n        pass\n{SHOWN}"
    assert last_line(code) == "heavy:"


def test_the_package_imports_nothing_heavy_and_knows_its_public_names():
    assert last_line("import sys, tb2rl; print({*tb2rl.__all__, '__version__'} <= set(dir(tb2rl)))") == "True"
    assert last_line(f"import sys, tb2rl; dir(tb2rl); {SHOWN}") == "heavy:"
    assert last_line("import tb2rl; print(tb2rl.__version__)") != ""


@pytest.mark.parametrize("first", ["import tb2rl, gymnasium", "import gymnasium, tb2rl"])
def test_gymnasium_knows_the_ids_in_either_order_of_imports(first):
    ids = "[id for id in gymnasium.registry if 'TurtleBot2' in id]"
    code = f"{first}; print(len({ids}), gymnasium.spec('TurtleBot2Maze-v0').kwargs)"
    assert last_line(code) == "10 {'task': 'maze'}"


def test_gymnasium_makes_an_environment_by_the_name_of_the_package():
    made = "gymnasium.make('tb2rl:TurtleBot2Maze-v0', simulation='kinematic', disable_env_checker=True)"
    assert last_line(f"import gymnasium; print({made}.reset(seed=0)[0].shape)") == "(7,)"
