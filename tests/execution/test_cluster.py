"""Jobs by Ray: on this machine, and on two nodes of which one is killed in the middle."""

import os
import socket
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import cloudpickle
import pytest

from tb2rl.core.errors import InputError
from tb2rl.execution.cluster import RayExecutor, UserModules, user_files

CHECKOUT = Path(__file__).parents[2]
SAME = ("final/policy.safetensors", "best/policy.safetensors", "episodes.safetensors", "config.yaml", "evaluation.json")
NODES = """
import os, sys
os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_worker_niceness": "0"}
from ray.cluster_utils import Cluster
few = {"num_cpus": 1, "object_store_memory": 2**27, "include_dashboard": False}
cluster = Cluster(initialize_head=True, head_node_args=few)
other = cluster.add_node(**few)
cluster.wait_for_nodes()
print(cluster.address, flush=True)
for _ in sys.stdin:
    cluster.remove_node(other, allow_graceful=False)
    print("killed", flush=True)
cluster.shutdown()
"""
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
SHORT = "--simulation kinematic --n-envs 16 --total-timesteps 102400 --set train.eval_freq=51200"
SHORT += " train.eval_episodes=20 task.world=mine.yaml"


@pytest.fixture
def nodes(ray, tmp_path):
    """The process that holds two nodes, of which a line on its stdin kills one, and their address."""
    with (tmp_path / "nodes.log").open("w") as log:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": log, "text": True}
        process = subprocess.Popen([sys.executable, "-c", NODES], env=environment(), **pipes)
        yield process, process.stdout.readline().strip()
        process.communicate(timeout=120)


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(CHECKOUT)}


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
    libraries = tmp_path / "laid_under" / "site-packages"
    libraries.mkdir(parents=True)
    (libraries / "library.py").touch()
    monkeypatch.syspath_prepend(libraries)
    monkeypatch.syspath_prepend(tmp_path)
    import_module("library")
    import_module("my_helper")
    files = user_files()
    assert {"my_helper.py", "package_of_mine/inner.py", "robot.urdf"} <= set(files)
    assert not any(name.startswith(("tb2rl", "numpy", "pytest", "library")) for name in files)
    (tmp_path / "modules").write_bytes(cloudpickle.dumps(UserModules()))
    code = (
        "import pickle, sys; from pathlib import Path; pickle.loads(Path(sys.argv[1]).read_bytes());"
        "import my_helper; print(my_helper.SQUARE, Path(my_helper.__file__).with_name('robot.urdf').is_file())"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "modules")]
    done = subprocess.run(command, cwd=libraries, env=environment(), capture_output=True, text=True, check=True)
    assert done.stdout == "49 True\n"


@pytest.mark.slow
def test_when_a_node_dies_every_seed_is_there_once_and_the_same_to_the_bit(nodes, workdir):
    def train(*words: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "tb2rl.train", "--task", "my_task:Mine", "--seeds", "0..7", "--name", "it"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return subprocess.Popen([*command, *words, *SHORT.split()], env=environment(), **pipes)

    cluster, address = nodes
    Path("my_task.py").write_text(TASK)
    Path("helper.py").write_text("REWARD = 4.0\n")
    Path("mine.yaml").write_text(WORLD)
    training = train("--on", f"ray:{address}")
    while not list(Path("runs").glob("*/*/it")):
        assert training.poll() is None, training.communicate()
        time.sleep(0.1)
    cluster.stdin.write("kill\n")
    cluster.stdin.flush()
    assert cluster.stdout.readline() == "killed\n"
    assert len(list(Path("runs").glob("*/*/it/seed-*"))) < 8, "the node was killed too late"
    said = training.communicate()[0]
    assert training.returncode == 0, said
    lines = [line.partition(":")[0] for line in said.splitlines() if line.startswith("seed ")]
    assert sorted(lines) == [f"seed {seed}" for seed in range(8)]
    Path("runs").rename("there")
    here = train()
    said = here.communicate()[0]
    assert here.returncode == 0, said
    for file in [file for name in SAME for file in Path("there").glob(f"*/*/it/seed-*/{name}")]:
        assert file.read_bytes() == Path("runs", *file.parts[1:]).read_bytes()
