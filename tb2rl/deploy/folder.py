"""A policy as a folder for a robot that has Python 3.8 and numpy, and nothing else: what it is, weights, one program.

The program is the modules of `portable/` in one file. So it can be read from top to bottom, mended on the robot, run
and imported; a zip archive could be run and imported just as well, but not read.
"""

from __future__ import annotations

import ast
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from tb2rl.core.files import replacing, write_text
from tb2rl.deploy.network import Network, in_a_row
from tb2rl.deploy.portable.policy import POLICY_FORMAT

_HERE = Path(__file__).parent
_FIRST = '''"""Drives a robot with the policy beside this file; it needs Python 3.8 and numpy. README.md says how.

Made by tb2rl of its modules tb2rl.deploy.portable, one after the other, so that there is one file to copy. MIT
licence.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # a KeyboardInterrupt can get lost in the imports below; this ends the program at once
    signal.signal(signal.SIGINT, signal.SIG_DFL)

'''


def write_folder(folder: Path, network: Network, about: Mapping[str, Any], needs: Mapping[str, Any]) -> None:
    """Write the folder of a policy; what else is in it stays.

    Args:
        folder: Is made if it is not there.
        network: The layers of the policy, whose observation has no parts.
        about: What it says of itself, see `describe`.
        needs: What it needs of a robot, see `needs_of`.

    Raises:
        OSError: If it cannot be written.
    """
    layers: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for number, layer in enumerate(in_a_row(network)):
        keys = {name: f"{number}.{name}" for name in layer.arrays}
        arrays |= {keys[name]: array for name, array in layer.arrays.items()}
        layers.append({"kind": layer.kind, "arrays": keys})
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / "weights.npz") as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    text = json.dumps({"format": POLICY_FORMAT, **about, "needs": needs, "layers": layers}, indent=1)
    in_lines = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), text)  # lists of numbers
    write_text(folder / "policy.json", in_lines + "\n")
    write_text(folder / "drive.py", program())
    write_text(folder / "README.md", _readme(about, needs))


def program() -> str:
    """The modules of `portable` as one Python file, each after those that it imports; no two share a name."""
    imports = dict[str, set[str]]()
    bodies = [
        f"\n\n# ---- {name} ----\n\n{_without_imports(_source(name), imports)}\n" for name in _in_order("main", [])
    ]
    plain = [f"import {module}" for module, names in sorted(imports.items()) if not names and module != "signal"]
    some = [f"from {module} import {', '.join(sorted(names))}" for module, names in sorted(imports.items()) if names]
    return _FIRST + "\n".join([*plain, *some, ""]) + "".join(bodies)


def _source(name: str) -> str:
    return (_HERE / "portable" / f"{name}.py").read_text(encoding="utf-8")


def _in_order(name: str, before: list[str]) -> list[str]:
    """The modules of `portable` that one imports and that are not there yet, each after its own, and the one itself."""
    for node in ast.parse(_source(name)).body:
        if isinstance(node, ast.ImportFrom) and node.level and node.module not in before:
            before = _in_order(str(node.module), before)
    return [*before, name]


def _without_imports(source: str, imports: dict[str, set[str]]) -> str:
    """A module without its imports; what it imports from elsewhere is added to `imports`, by module."""
    lines: list[str | None] = [*source.splitlines()]
    for node in ast.parse(source).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            for number in range(node.lineno - 1, node.end_lineno or node.lineno):
                lines[number] = None
        if isinstance(node, ast.Import):
            imports.update({ast.unparse(node).removeprefix("import "): set()})
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module != "__future__":
            imports.setdefault(str(node.module), set()).update(alias.name for alias in node.names)
    text = "\n".join(line for line in lines if line is not None)
    return re.sub(r"\n{4,}", "\n\n\n", text).strip()


def _readme(about: Mapping[str, Any], needs: Mapping[str, Any]) -> str:
    text, beams = (_HERE / "folder.md").read_text(encoding="utf-8"), needs["beams"]
    goals = {None: "it has none", "goal": "x and y", "plan": "a planned way to it, or a planner that knows one"}
    words = {
        "beams": len(beams),
        "field": f"{math.degrees(beams[-1] - beams[0]):.0f}",
        "odometry": "needed" if needs["uses_odometry"] else "not needed",
        "goal": goals[needs["goal"]],
    }
    return Template(text).substitute({**about, **needs, **words})
