"""What is installed is what is in the checkout: agents, configs and zoo come along."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parent.parent
USE = """
import tb2rl
from tb2rl.config import resolve
from tb2rl.maze import load_maze, maze_names
from tb2rl.registry import agent_names, find_agent, task_names
from tb2rl.settings import room

print(tb2rl.__file__)
print(*agent_names(), *task_names(), *maze_names(), *sorted(entry.name for entry in room("zoo").iterdir()))
for name in maze_names():
    load_maze(name)
for name in agent_names():
    resolve(name, preset="tutorial" if name == "qlearn" else None), find_agent(name)
env = tb2rl.make_env("maze", "raw")
env.reset(seed=0)
for _ in range(5):
    env.step(0)
"""


def use(code: str, folder: Path, *flags: str) -> list[str]:
    """Run code with the site-packages of this Python, but without the .pth files in them: nothing editable is seen."""
    start = f"import sys; sys.path.append({sysconfig.get_path('purelib')!r})"
    arguments = [sys.executable, "-S", *flags, "-c", f"{start}\n{code}"]
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_a_wheel_has_everything_that_the_checkout_has(tmp_path):
    source, target = tmp_path / "source", tmp_path / "target"
    away = shutil.ignore_patterns(".*", "runs", "build", "dist", "*.egg-info", "__pycache__", "*.nb?")
    shutil.copytree(CHECKOUT, source, ignore=away)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    wheel = ["wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path), str(source)]
    subprocess.run([*pip, *wheel], check=True)
    (built,) = tmp_path.glob("tb2rl-*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", str(target), str(built)], check=True)
    shutil.rmtree(source)

    where, names = use(f"sys.path.insert(0, {str(target)!r})\n{USE}", tmp_path, "-I")
    assert Path(where).is_relative_to(target)
    assert [names] == use(USE, CHECKOUT)[1:]
    installed = {str(file.relative_to(target / "tb2rl")) for file in (target / "tb2rl").rglob("*")}
    assert {"assets/turtlebot2.urdf", "py.typed", "configs/mazes/loop.yaml"} <= installed
    zoo = {str(file.relative_to(CHECKOUT)) for file in (CHECKOUT / "zoo").rglob("*") if "__pycache__" not in file.parts}
    assert zoo <= installed


@pytest.mark.slow
def test_a_checkout_works_without_an_install():
    where, _ = use(USE, CHECKOUT)
    assert Path(where).parent == CHECKOUT / "tb2rl"
