"""What goes to robots runs there: on Python 3.8, with numpy and nothing else, packed into one file."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tb2rl

PORTABLE = Path(tb2rl.__file__).parent / "deploy" / "portable"
MODULES = sorted(PORTABLE.glob("*.py"))


def tree_of(module: Path) -> ast.Module:
    """Its syntax, which must be that of Python 3.8."""
    return ast.parse(module.read_text(encoding="utf-8"), feature_version=(3, 8))


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.stem)
def test_it_imports_the_standard_library_numpy_and_its_neighbours(module):
    for node in ast.walk(tree_of(module)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            assert node.level < 2
            assert node.level == 0 or node.module is not None, "one file has no names of modules"
            assert not any(alias.asname for alias in node.names)
            names = [node.module] if node.level == 0 else []
        assert {name.split(".")[0] for name in names} <= {"numpy", *sys.stdlib_module_names}


def test_no_name_stands_at_the_top_of_two_modules():
    defined = []
    for module in MODULES:
        for node in tree_of(module).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                defined.append(node.name)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = [name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
                defined.extend(name.id for name in names)
    assert sorted(defined) == sorted(set(defined))


def test_it_drives_where_there_is_no_tb2rl(tmp_path):
    shutil.copytree(PORTABLE, tmp_path / "portable", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "drive.py").write_text(DRIVE)
    python = _python_3_8() or sys.executable
    done = subprocess.run([python, "drive.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.stderr, done.stdout.split()) == ("", ["0.3", "0.0", "driving", "False"])


def _python_3_8() -> str | None:
    """The oldest Python that it is to run on, if it is here with numpy."""
    python = shutil.which("python3.8")
    if python and subprocess.run([python, "-c", "import numpy"], capture_output=True, check=False).returncode == 0:
        return python
    return None


DRIVE = """
import math, sys
import numpy as np
from portable.driver import Driver
from portable.policy_contract import Needs
from portable.readings import Scan

class Straight:
    needs = Needs(np.linspace(-1.5, 1.5, 9), 0.1, 6.0, 0.2, 0.5, 1.0, "turtlebot2")
    def begin(self): pass
    def act(self, sensed): return 0.3, 0.0

driver = Driver(Straight())
driver.see_scan(Scan(np.full(360, 2.0), -math.pi, math.tau / 360, 0.1, 8.0), 0.0)
driver.start()
command = driver.command(0.1)
print(command.v, command.w, command.why, any(name.startswith(("tb2rl", "torch")) for name in sys.modules))
"""
