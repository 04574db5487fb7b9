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
    nodes = list(ast.walk(ast.parse(module.read_text())))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name for name in names if name.split(".")[0] == "tb2rl"}


def test_contract_picture_and_folders_have_the_same_rooms():
    contracts = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    folders = {file.parent.name for file in (CHECKOUT / "tb2rl").glob("*/__init__.py")}
    rooms = [name for name in " | ".join(layers).split(" | ") if name in {*folders, "commands"}]
    assert {*rooms} == folders
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


@pytest.mark.parametrize(
    ("pattern", "places"),
    [
        (r"find_world\(", {"tb2rl/worlds/registry.py", "tb2rl/envs/worlds.py", "tb2rl/commands/worlds.py"}),
        (r"read_world\(", {"tb2rl/worlds/readers.py", "tb2rl/worlds/registry.py"}),
        (r"(?m)^\s*(import|from) pybullet", {"tb2rl/simulation/bullet/client.py"}),
        (r"(?m)^\s*from numba import .*\bnjit|@numba", set()),
    ],
    ids=["worlds by name", "worlds by file", "PyBullet", "numba's compiler"],
)
def test_each_decision_has_its_place(pattern, places):
    found = (module for module in MODULES if re.search(pattern, module.read_text()))
    assert {str(module.relative_to(CHECKOUT)) for module in found} == places


def test_references_are_imported_in_one_module():
    """Except names of our own that a package loads lazily, and messages of ROS, which may not be installed."""
    found = {str(module.relative_to(CHECKOUT)) for module in MODULES if "import_module(" in module.read_text()}
    lazy = {name for name in found if name.endswith(("__init__.py", "__main__.py")) or "ros" in name}
    assert found - lazy == {"tb2rl/core/plugins.py"}
