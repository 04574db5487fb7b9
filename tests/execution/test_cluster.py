"""Jobs by Ray: on this machine, and on two nodes of which one is killed in the middle."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest

from tb2rl.core.errors import InputError
from tb2rl.execution.cluster import RayExecutor
from tb2rl.execution.modules import UserModules
from tb2rl.execution.payload import serialize

CHECKOUT = Path(__file__).parents[2]
HERE = Path(__file__).parent
SAME = ("final/policy.safetensors", "best/policy.safetensors", "episodes.safetensors", "config.yaml")
TASK = """
from dataclasses import dataclass
from helper import REWARD
from tb2rl.tasks.wander import Wander

@dataclass(frozen=True)
class Mine(Wander):
    forward_reward: float = REWARD
    turn_speed: float = 0.5  # in circles for which its world is too small: whatever was learned, an evaluation is short
    turn_rate: float = 0.12
"""
WORLD = "cell: 2.0\ndrawing: |\n  #####\n  #.S.#\n  #...#\n  #...#\n  #####\n"
SHORT = "--simulation kinematic --n-envs 16 --total-timesteps 102400 --set train.eval_freq=51200 train.eval_episodes=20"


@pytest.fixture
def nodes(ray, tmp_path):
    """Two nodes: the process that holds them, and their address."""
    with (tmp_path / "nodes.log").open("w") as log:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": log, "text": True}
        process = subprocess.Popen([sys.executable, str(HERE / "nodes.py")], env=environment(), **pipes)
        yield process, process.stdout.readline().strip()
        process.communicate(timeout=120)


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(CHECKOUT)}


def started(command: str, *words: str) -> subprocess.Popen:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-m", f"tb2rl.{command}", *words], env=environment(), **pipes)


def ended(process: subprocess.Popen) -> str:
    out, error = process.communicate(timeout=900)
    assert process.returncode == 0, out + error
    return out


@pytest.mark.slow  # as all tests that need Ray, which CI installs for the slow ones
def test_a_cluster_that_does_not_answer_is_named_at_once(ray):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{unused.getsockname()[1]}"
    with pytest.raises(InputError, match=f"no usable Ray cluster at {address}: .*refused"):
        list(RayExecutor(address).map(abs, [1]))
    with pytest.raises(InputError, match="HOST:PORT, as `ray start` prints it, got 'head'"):
        list(RayExecutor("head").map(abs, [1]))


def test_modules_of_a_user_travel_along(tmp_path, monkeypatch):
    (tmp_path / "my_helper.py").write_text("from package_of_mine.inner import NUMBER\nSQUARE = NUMBER**2\n")
    (tmp_path / "package_of_mine").mkdir()
    (tmp_path / "package_of_mine" / "__init__.py").touch()
    (tmp_path / "package_of_mine" / "inner.py").write_text("NUMBER = 7\n")
    (tmp_path / "robot.urdf").write_text("<robot/>")
    (tmp_path / "laid_under" / "site-packages").mkdir(parents=True)
    (tmp_path / "laid_under" / "site-packages" / "library.py").touch()
    monkeypatch.syspath_prepend(tmp_path / "laid_under" / "site-packages")
    monkeypatch.syspath_prepend(tmp_path)
    import_module("library")
    import_module("my_helper")
    modules = UserModules()
    files = modules.files
    assert {"my_helper.py", "package_of_mine/inner.py", "robot.urdf"} <= set(files)
    assert not any(name.startswith(("tb2rl", "numpy", "pytest", "library")) for name in files)
    (tmp_path / "modules").write_bytes(serialize(modules).content)
    code = (
        "import pickle, sys; from pathlib import Path; pickle.loads(Path(sys.argv[1]).read_bytes());"
        "import my_helper; print(my_helper.SQUARE, Path(my_helper.__file__).with_name('robot.urdf').is_file())"
    )
    other = tmp_path / "other"
    other.mkdir()
    command = [sys.executable, "-c", code, str(tmp_path / "modules")]
    done = subprocess.run(command, cwd=other, env=environment(), capture_output=True, text=True, check=True)
    assert done.stdout == "49 True\n"


@pytest.mark.slow
def test_when_a_node_dies_every_seed_is_there_once_and_the_same_to_the_bit(nodes, tmp_path, monkeypatch):
    cluster, address = nodes
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_task.py").write_text(TASK)
    (tmp_path / "helper.py").write_text("REWARD = 4.0\n")
    (tmp_path / "mine.yaml").write_text(WORLD)
    words = ["--task", "my_task:Mine", "--seeds", "0..7", *SHORT.split(), "task.world=mine.yaml"]
    folders = Path("runs/my_task:Mine/qlearn"), Path("runs/Mine/qlearn")
    training = started("train", *words, "--name", "it", "--on", f"ray:{address}")
    while not any((folder / "it").is_dir() for folder in folders):
        assert training.poll() is None, training.communicate()
        time.sleep(0.1)
    cluster.stdin.write("kill\n")
    cluster.stdin.flush()
    assert cluster.stdout.readline() == "killed\n"
    done = len(list(Path("runs").glob("*/*/it/seed-*")))
    said = ended(training)
    assert done < 8, "the node was killed too late"
    lines = [line.partition(":")[0] for line in said.splitlines() if line.startswith("seed ")]
    assert sorted(lines) == [f"seed {seed}" for seed in range(8)]
    (there,) = Path("runs").glob("*/*/it")
    kept = tmp_path / "kept"
    there.rename(kept)
    ended(started("train", *words, "--name", "it"))
    for seed in range(8):
        for name in (*SAME, "evaluation.json"):
            assert (kept / f"seed-{seed}" / name).read_bytes() == (there / f"seed-{seed}" / name).read_bytes()
