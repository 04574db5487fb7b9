"""The layout of the package: short modules, one place for each decision, and imports that take no time.

`lint-imports` checks the order of the rooms and circles, but does not see agents/ and imports by string.
"""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tb2rl.__main__ import COMMANDS

CHECKOUT = Path(__file__).parent.parent
MODULES = [*(CHECKOUT / "tb2rl").rglob("*.py"), *(CHECKOUT / "agents").glob("*.py"), *(CHECKOUT / "zoo").glob("*.py")]
TEXTS = {module.relative_to(CHECKOUT).as_posix(): module.read_text(encoding="utf-8") for module in MODULES}
FOR_AGENTS = {"tb2rl", "tb2rl.core.values", "tb2rl.core.compiled", "tb2rl.core.errors", "tb2rl.robots.vehicle"}


def test_contract_picture_and_folders_have_the_same_rooms():
    contracts = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    folders = {file.parent.name for file in (CHECKOUT / "tb2rl").glob("*/__init__.py")}
    rooms = [name for name in " | ".join(layers).split(" | ") if name in folders]
    assert {*rooms} == folders
    shown = re.findall(
        r'font-weight="600">(\w+)/?</text>', (CHECKOUT / "zoo/pictures/architecture.svg").read_text(encoding="utf-8")
    )
    assert [name for name in shown if name in rooms] == rooms


def test_modules_are_short():
    assert {name: lines for name, text in TEXTS.items() if (lines := text.count("\n")) > 300} == {}


def test_every_module_is_in_the_repository():
    if not (CHECKOUT / ".git").exists():
        pytest.skip("not a checkout of the repository")
    command = ["git", "ls-files", "--others", "--ignored", "--exclude-standard", "tb2rl", "agents", "zoo", "tests"]
    ignored = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=True).stdout.splitlines()
    assert [file for file in ignored if file.endswith(".py")] == []


def test_agents_import_little_and_nothing_imports_agents():
    for name, text in TEXTS.items():
        imported = set(re.findall(r"^\s*(?:from|import) (tb2rl[\w.]*)", text, flags=re.MULTILINE))
        agents = {module for module in imported if module.startswith("tb2rl.agents")}
        if name.startswith("agents/"):
            assert imported - agents <= FOR_AGENTS, name
        else:
            assert not agents, name


def test_one_module_imports_pybullet_and_one_compiles():
    bullet, numba = r"(?m)^\s*(import|from) pybullet", r"(?m)^\s*from numba import .*\bnjit|@numba"
    found = {name for name, text in TEXTS.items() if re.search(bullet, text) or re.search(numba, text)}
    assert found == {"tb2rl/simulation/bullet/client.py"}


# ---- imports

VIEWER = "viser yourdfpy trimesh"
HEAVY = f"torch numba stable_baselines3 pybullet mujoco tensorboard pydantic shapely matplotlib optuna {VIEWER}"
SHOWN = f"print('heavy:', *[name for name in {HEAVY!r}.split() if name in sys.modules])"
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


WITHOUT_A_PAGE = f"""
import sys
from importlib import import_module
for line in (
    "train --total-timesteps 64 --eval-freq 0 --no-evaluation --name it",
    "evaluate runs/maze/qlearn/it --episodes 1 --steps 2",
    "play runs/maze/qlearn/it --steps 2 --video it.gif",
):
    name, *arguments = line.split()
    import_module(f"tb2rl.{{name}}").main([*arguments, "--simulation", "kinematic"])
print(*[name for name in {VIEWER!r}.split() if name in sys.modules])
"""


@pytest.mark.slow
def test_only_a_page_imports_the_viewer(workdir):
    assert last_line(WITHOUT_A_PAGE) == ""


@pytest.mark.slow
def test_the_functions_of_the_package_are_functions_whatever_was_imported_before():
    shown = "print([name for name in tb2rl.__all__ if not callable(getattr(tb2rl, name))])"
    assert last_line(f"import tb2rl.train, tb2rl.evaluate; {shown}") == "[]"
