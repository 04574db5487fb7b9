"""The installed package has agents, configs and zoo, as the checkout has."""

import json
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parent.parent
PYPROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))
USE = """
import tb2rl
from tb2rl.core.files import top_folder
from tb2rl.core.plugins import agent_names, find_plugin, robot_names, simulator_names, task_names
from tb2rl.worlds.registry import find_world, world_names
from tb2rl.runs.config import resolve

print(tb2rl.__file__)
names = {"agent": agent_names(), "task": task_names(), "robot": robot_names(), "simulator": simulator_names()}
print(names, *map(find_world, world_names()))
print(*sorted(file.parent.name for file in top_folder("zoo").glob("*/config.yaml")))
print(*[find_plugin("robot", name).urdf.is_file() for name in names["robot"]])
for name in {*agent_names()} - {"recurrent_ppo"}:  # it needs the extra "contrib"
    resolve(name, preset="tutorial" if name == "qlearn" else None)
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
COMPILED = """
import sys
from numba.core.dispatcher import Dispatcher

modules = [vars(module) for name, module in sys.modules.items() if name.startswith("tb2rl.")]
ours = [value for module in modules for value in module.values() if isinstance(value, Dispatcher)]
assert ours
print(sum(sum(each.stats.cache_misses.values()) for each in ours))
"""
PIP = ["-m", "pip", "--disable-pip-version-check", "--quiet"]


def run(command: list[str], folder: Path) -> list[str]:
    return subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, text=True, check=True).stdout.splitlines()


def from_checkout(code: str) -> list[str]:
    """Run code in the checkout with this Python's site-packages but without .pth files, so no editable install."""
    start = f"import sys; sys.path.append({sysconfig.get_path('purelib')!r})"
    return run([sys.executable, "-S", "-c", f"{start}\n{code}"], CHECKOUT)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The Python of an empty environment with a wheel installed as in the README; its source is removed."""
    folder = tmp_path_factory.mktemp("installed")
    source, python = folder / "source", str(folder / "environment" / Path(sys.executable).parent.name / "python")
    away = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__", "*.nb?")
    shutil.copytree(CHECKOUT, source, ignore=away)
    shutil.rmtree(source / "runs", ignore_errors=True)  # runs of the user, not the package tb2rl.runs
    (source / "zoo" / "drive.mp4").write_bytes(b"output of the notebook")
    run([sys.executable, *PIP, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", ".", str(source)], folder)
    (built,) = folder.glob("tb2rl-*.whl")
    shutil.rmtree(source)
    run([sys.executable, "-m", "venv", "environment"], folder)
    for what in ("torch", str(built)):
        run([python, *PIP, "install", "--constraint", str(CHECKOUT / "constraints.txt"), what], folder)
    return python


def test_every_folder_of_modules_is_packaged():
    folders = {".".join(file.relative_to(CHECKOUT).parent.parts) for file in (CHECKOUT / "tb2rl").rglob("__init__.py")}
    assert folders | {"tb2rl.agents", "tb2rl.configs", "tb2rl.zoo"} == {*PYPROJECT["tool"]["setuptools"]["packages"]}


@pytest.mark.skipif(not shutil.which("make"), reason="there is no make")
@pytest.mark.parametrize("python", ["", "false", "no-such-python"])
def test_make_without_a_fitting_python_names_the_section_for_other_systems(python, tmp_path):
    command = ["make", "--silent", "--always-make", f"PYTHON={python}", f"VENV={tmp_path / 'venv'}", "test"]
    done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    section = re.search(r"see '(.+?)' in (\S+)", done.stderr)
    assert section, done.stderr
    assert f"\n## {section[1]}\n" in (CHECKOUT / section[2]).read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_wheel_has_everything_that_the_checkout_has(installed, tmp_path):
    where, *names = run([installed, "-I", "-c", USE], tmp_path)
    package = Path(where).parent
    assert package.is_relative_to(Path(installed).parent.parent)
    assert names == from_checkout(USE)[1:]
    there = {file.relative_to(package).as_posix() for file in package.rglob("*")}
    data = {"py.typed", "robots/turtlebot2.urdf", "viz/replay.js", "deploy/folder.md", "configs/worlds/loop.yaml"}
    zoo = {file.relative_to(CHECKOUT) for file in (CHECKOUT / "zoo").rglob("*")}
    alone = {"__pycache__", "pictures"}  # the pictures are the README's
    assert data | {file.as_posix() for file in zoo if not alone & set(file.parts)} <= there
    assert not {"zoo/drive.mp4", "zoo/pictures"} & there


@pytest.mark.slow
def test_the_installed_command_runs_and_gymnasium_knows_the_ids(installed, tmp_path):
    command = str(Path(installed).with_name("tb2rl"))
    assert run([command, "--version"], tmp_path)[0].split()[0] == "tb2rl"
    assert run([command, "evaluate", "--help"], tmp_path)[0].startswith("usage: python -m tb2rl.evaluate")
    assert run([installed, "-I", "-c", IDS], tmp_path) == ["10 (7,)"]


@pytest.mark.slow
def test_a_read_only_installation_uses_the_code_compiled_by_warm(installed, guest, tmp_path):
    (package,) = Path(installed).parent.parent.glob("lib/*/site-packages/tb2rl")
    for folder in package.rglob("__pycache__"):
        shutil.rmtree(folder)
    guest.lock(package)
    warnings, _ = drive_as(guest, installed)
    assert warnings.count("RuntimeWarning: tb2rl:") == 1
    assert "NUMBA_CACHE_DIR" in warnings
    guest.unlock()
    assert "compiled" in run([installed, "-I", "-m", "tb2rl.warm"], tmp_path)[0]
    guest.lock(package)
    for simulation in ("kinematic", "bullet"):
        assert drive_as(guest, installed, simulation) == ("", 0), "nothing is compiled"


def drive_as(guest, python: str, simulation: str = "kinematic") -> tuple[str, int]:
    """Run the notebook's first cell as a guest; returns its stderr and the number of functions that it compiled."""
    cells = json.loads((CHECKOUT / "zoo" / "quickstart.ipynb").read_text(encoding="utf-8"))["cells"]
    code = next("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert 'simulation="kinematic"' in code
    done = guest.run([python, "-I", "-c", f"{code.replace('kinematic', simulation)}\n{COMPILED}"])
    assert done.returncode == 0, done.stderr
    return done.stderr, int(done.stdout.splitlines()[-1])


@pytest.mark.slow
def test_a_checkout_works_without_an_install():
    assert from_checkout(IDS) == ["10 (7,)"]
    assert Path(from_checkout(USE)[0]).parent == CHECKOUT / "tb2rl"


def test_messages_install_extras_that_exist():
    text = "\n".join(file.read_text(encoding="utf-8") for file in (CHECKOUT / "tb2rl").rglob("*.py"))
    asked = set(re.findall(r"install_extra\(['\"](\w+)['\"]\)", text))
    assert asked <= PYPROJECT["project"]["optional-dependencies"].keys()
