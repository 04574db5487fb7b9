"""The layout of the package: short modules, few dependencies of agents, and one place for each decision.

`lint-imports` checks the order of the rooms and circles, but does not see agents/ and imports by string.
"""

from __future__ import annotations

import ast
import re
import statistics
import subprocess
import tomllib
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parent.parent
MODULES = [*(CHECKOUT / "tb2rl").rglob("*.py"), *(CHECKOUT / "agents").glob("*.py"), *(CHECKOUT / "zoo").glob("*.py")]
FOR_AGENTS = {"tb2rl", "tb2rl.core.values", "tb2rl.core.compiled", "tb2rl.core.errors", "tb2rl.robots.vehicle"}


def imported(module: Path) -> set[str]:
    """The modules of tb2rl that a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return {name for name in names if name.split(".")[0] == "tb2rl"}


def mentioning(pattern: str) -> set[str]:
    found = (module for module in MODULES if re.search(pattern, module.read_text()))
    return {str(module.relative_to(CHECKOUT)) for module in found}


def test_the_picture_shows_the_rooms_in_the_order_of_the_contract():
    contracts = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    rooms = [name for layer in layers for name in layer.split(" | ") if (CHECKOUT / "tb2rl" / name).is_dir()]
    shown = re.findall(r'font-weight="600">(\w+)/?</text>', (CHECKOUT / "zoo/pictures/architecture.svg").read_text())
    assert [name for name in shown if name in rooms] == rooms


def test_modules_are_short():
    sizes = {str(module.relative_to(CHECKOUT)): len(module.read_text().splitlines()) for module in MODULES}
    assert {name: size for name, size in sizes.items() if size > 300} == {}
    assert statistics.median(sizes.values()) <= 120


def test_every_module_is_in_the_repository():
    if not (CHECKOUT / ".git").exists():
        pytest.skip("not a checkout of the repository")
    command = ["git", "ls-files", "--others", "--ignored", "--exclude-standard", "tb2rl", "agents", "zoo", "tests"]
    ignored = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=True).stdout.splitlines()
    assert [file for file in ignored if file.endswith(".py")] == []


def test_agents_import_little_and_nothing_imports_agents():
    for module in (CHECKOUT / "agents").glob("*.py"):
        assert {name for name in imported(module) if not name.startswith("tb2rl.agents.")} <= FOR_AGENTS
    importing = {module for module in MODULES if any(name.startswith("tb2rl.agents") for name in imported(module))}
    assert {module.parent.name for module in importing} == {"agents"}


def test_references_are_imported_in_one_module():
    """Except names of our own that a package loads lazily, and messages of ROS, which may not be installed."""
    found = {name for name in mentioning(r"import_module\(") if not name.endswith(("__init__.py", "__main__.py"))}
    assert {name for name in found if "ros" not in name} == {"tb2rl/core/plugins.py"}


def test_a_world_is_loaded_by_its_name_in_one_module():
    where = {"tb2rl/worlds/registry.py", "tb2rl/envs/worlds.py", "tb2rl/commands/worlds.py"}
    assert mentioning(r"find_world\(") == where
    assert mentioning(r"read_world\(") == {"tb2rl/worlds/readers.py", "tb2rl/worlds/registry.py"}


def test_pybullet_and_numbas_compiler_are_imported_in_one_module_each():
    assert mentioning(r"(?m)^\s*(import|from) pybullet") <= {"tb2rl/simulation/physics.py"}
    assert mentioning(r"(?m)^\s*from numba import .*\bnjit|@numba") == set()
