"""What is installed is what is in the checkout: agents, configs and zoo come along."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parent.parent
USE = """
import tb2rl
from tb2rl.files import top_folder
from tb2rl.registry import (
    agent_names, find_agent, find_robot, find_task, find_world, robot_names, task_names, world_names,
)
from tb2rl.runs.layers import resolve

print(tb2rl.__file__)
print(*agent_names(), *task_names(), *robot_names(), *world_names())
print(*sorted(file.parent.name for file in top_folder("zoo").glob("*/config.yaml")))
for name in world_names():
    find_world(name)
for name in robot_names():
    print(find_robot(name).urdf.is_file())
for name in task_names():
    find_task(name)
for name in agent_names():
    resolve(name, preset="tutorial" if name == "qlearn" else None), find_agent(name)
env = tb2rl.make_env("maze", "raw")
env.reset(seed=0)
for _ in range(5):
    env.step(0)
"""

IDS = """
import gymnasium, tb2rl
env = gymnasium.make("tb2rl:TurtleBot2Maze-v0", simulation="kinematic", disable_env_checker=True)
print(len([name for name in gymnasium.registry if "TurtleBot2" in name]), env.reset(seed=0)[0].shape)
"""
PIP = ["-m", "pip", "--disable-pip-version-check", "--quiet"]


def use(code: str, folder: Path) -> list[str]:
    """Run code with the site-packages of this Python, but without the .pth files in them: nothing editable is seen."""
    start = f"import sys; sys.path.append({sysconfig.get_path('purelib')!r})"
    return run([sys.executable, "-S", "-c", f"{start}\n{code}"], folder)


def run(command: list[str], folder: Path) -> list[str]:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The Python of an empty environment into which a wheel was installed as the README says; its source is gone."""
    folder = tmp_path_factory.mktemp("installed")
    source, environment = folder / "source", folder / "environment"
    away = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__", "*.nb?")
    shutil.copytree(CHECKOUT, source, ignore=away)
    shutil.rmtree(source / "runs", ignore_errors=True)  # of trainings; the package tb2rl.runs stays
    (source / "zoo" / "drive.mp4").write_bytes(b"what the notebook leaves beside itself")
    wheel = ["wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(source)]
    subprocess.run([sys.executable, *PIP, *wheel], check=True)
    (built,) = folder.glob("tb2rl-*.whl")
    shutil.rmtree(source)
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    python = str(environment / "bin" / "python")
    for what in ("torch", str(built)):
        subprocess.run([python, *PIP, "install", "--constraint", str(CHECKOUT / "constraints.txt"), what], check=True)
    return python


@pytest.mark.slow
def test_a_wheel_has_everything_that_the_checkout_has(installed, tmp_path):
    where, *names = run([installed, "-I", "-c", USE], tmp_path)
    package = Path(where).parent
    assert package.is_relative_to(Path(installed).parent.parent)
    assert names == use(USE, CHECKOUT)[1:]
    there = {str(file.relative_to(package)) for file in package.rglob("*")}
    assert {"py.typed", "robots/turtlebot2.urdf", "showing/page.html", "configs/worlds/loop.yaml"} <= there
    modules = {str(file.relative_to(CHECKOUT / "tb2rl")) for file in (CHECKOUT / "tb2rl").rglob("*.py")}
    assert modules <= there
    zoo = {file.relative_to(CHECKOUT) for file in (CHECKOUT / "zoo").rglob("*")}
    alone = {"__pycache__", "pictures"}  # the picture is the README's
    assert {str(file) for file in zoo if not alone & set(file.parts)} <= there
    assert not {"zoo/drive.mp4", "zoo/pictures"} & there


@pytest.mark.slow
def test_the_installed_command_runs_and_gymnasium_knows_the_ids(installed, tmp_path):
    command = str(Path(installed).with_name("tb2rl"))
    assert run([command, "--version"], tmp_path)[0].split()[0] == "tb2rl"
    assert run([command, "evaluate", "--help"], tmp_path)[0].startswith("usage: python -m tb2rl.evaluate")
    assert run([installed, "-I", "-c", IDS], tmp_path) == ["6 (7,)"]


@pytest.mark.slow
def test_an_installed_report_finds_its_template(installed, tmp_path):
    code = "from tb2rl.showing import page; page._template()"
    assert run([installed, "-I", "-c", code], tmp_path) == []


@pytest.mark.slow
def test_an_installed_policy_drives_in_the_first_cell_of_the_notebook(installed, tmp_path):
    cells = json.loads((CHECKOUT / "zoo" / "quickstart.ipynb").read_text(encoding="utf-8"))["cells"]
    first = next("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert "zoo:" in first
    *_, steps, distance = run([installed, "-I", "-c", f"{first}\nprint(env._steps, info['distance'])"], tmp_path)[
        -1
    ].split()
    assert (int(steps), float(distance) > 10.0) == (200, True)


@pytest.mark.slow
def test_a_checkout_works_without_an_install():
    assert use(IDS, CHECKOUT) == ["6 (7,)"]
    where, *_ = use(USE, CHECKOUT)
    assert Path(where).parent == CHECKOUT / "tb2rl"
