"""Jobs by Ray: on this machine, and on two nodes of which one is killed in the middle."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest

from tb2rl.core.errors import InputError
from tb2rl.execution.cargo import packed
from tb2rl.execution.running import run_jobs
from tb2rl.execution.where import Where

CHECKOUT = Path(__file__).parents[2]
HERE = Path(__file__).parent
needs_ray = pytest.mark.usefixtures("ray")
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
    with pytest.raises(InputError, match=f"there is no Ray cluster for us at {address}: .*refused"):
        Where(True, address).open(None)
    with pytest.raises(InputError, match="HOST:PORT, as `ray start` says it, got 'head'"):
        Where(True, "head").open(None)


def test_what_a_user_wrote_travels_along(tmp_path, monkeypatch):
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
    cargo = packed({"offset": 3})
    files = pickle.loads(cargo)[0]
    assert {"my_helper.py", "package_of_mine/inner.py", "robot.urdf"} <= set(files)
    assert not any(name.startswith(("tb2rl", "numpy", "pytest", "library")) for name in files)
    (tmp_path / "cargo").write_bytes(cargo)
    code = (
        "import sys; from pathlib import Path; from tb2rl.execution.cargo import unpacked;"
        f"shared = unpacked(Path({str(tmp_path / 'cargo')!r}).read_bytes());"
        "import my_helper; print(my_helper.SQUARE, shared, Path(my_helper.__file__).with_name('robot.urdf').is_file())"
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=elsewhere, env=environment(), capture_output=True, text=True, check=True)
    assert done.stdout == "49 {'offset': 3} True\n"


@pytest.mark.slow
@needs_ray
def test_ray_on_this_machine_does_what_processes_do(make_job, tmp_path):
    on_ray = Where(ray=True, workers=2)
    jobs = [make_job(f"job {i}", "square", i, folder=tmp_path / str(i)) for i in range(5)]
    done = {job.name: value for job, value in run_jobs(jobs, on_ray, {"offset": 100})}
    assert done == {f"job {i}": 100 + i**2 for i in range(5)}
    assert [(tmp_path / str(i) / "inner" / "square.txt").read_text() for i in range(5)] == ["0", "1", "4", "9", "16"]
    with pytest.raises(InputError, match=r"^seed 3: it does not fit$"):
        list(run_jobs([make_job("seed 3", "refuse")], on_ray))
    dying = make_job("it", "die_once", tmp_path / "note", folder=tmp_path / "folder")
    assert [value for _, value in run_jobs([dying], on_ray)] == ["done"]
    assert len(list((tmp_path / "folder").iterdir())) == 1
    assert [value for _, value in run_jobs([make_job("it", "threads")], on_ray)] == [(1, 1, 1)]
    with pytest.raises(InputError, match="it: Ray gave it up: "):
        list(run_jobs([make_job("it", "die")], on_ray))


@pytest.mark.slow
@needs_ray
def test_ctrl_c_ends_ray_and_what_it_ran(tmp_path):
    running = import_module("tests.jobs.test_running")
    process, workers = running.interrupted("ray", tmp_path, signal.SIGINT)
    assert process.returncode != 0
    assert running.ended(workers)


@pytest.mark.slow
@needs_ray
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
