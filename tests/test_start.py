"""Starting is quick: `import tb2rl` and every `--help` leave alone what takes seconds to import."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from tb2rl.__main__ import COMMANDS

HEAVY = (
    "torch", "numba", "stable_baselines3", "pybullet", "tensorboard", "pydantic", "shapely", "matplotlib", "optuna",
)  # fmt: skip
SHOWN = f"print('heavy:', *[name for name in {HEAVY} if name in sys.modules])"
IDS = "[id for id in gymnasium.registry if 'TurtleBot2' in id]"


def said(code: str, *options: str) -> str:
    """The last line that a new Python prints."""
    done = subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize("module", ["tb2rl.__main__", *COMMANDS.values()])
def test_help_is_there_at_once(module):
    code = f"import sys; from {module} import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    {SHOWN}"
    started = time.monotonic()
    assert said(code) == "heavy:"
    assert time.monotonic() - started < 5.0, "0.5 s on a machine with nothing else to do"


def test_the_package_is_imported_at_once():
    began = "import sys, time; before = time.perf_counter(); import tb2rl; took = time.perf_counter() - before"
    assert said(f"{began}; {SHOWN}") == "heavy:"
    assert min(float(said(f"{began}; print(took)")) for _ in range(3)) < 1.0, "0.15 s with nothing else to do"


def test_completion_knows_the_public_names_without_importing_what_they_need():
    shown = "print({*tb2rl.__all__, '__version__'} <= set(dir(tb2rl)), 'torch' in sys.modules)"
    assert said(f"import sys, tb2rl; {shown}") == "True False"
    assert said("import tb2rl; print(tb2rl.__version__)") != ""


@pytest.mark.parametrize("first", ["import tb2rl, gymnasium", "import gymnasium, tb2rl"])
def test_gymnasium_knows_the_ids_in_whatever_order_both_are_imported(first):
    name = "TurtleBot2Maze-v0"
    code = f"{first}; print(len({IDS}), gymnasium.spec('{name}').kwargs)"
    assert said(code) == "10 {'task': 'maze'}"


def test_gymnasium_makes_an_environment_by_the_name_of_the_package():
    made = "gymnasium.make('tb2rl:TurtleBot2Maze-v0', simulation='kinematic', disable_env_checker=True)"
    assert said(f"import gymnasium; print({made}.reset(seed=0)[0].shape)") == "(7,)"
