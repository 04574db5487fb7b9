"""PyBullet's own lines are kept from the user, and nothing else is, with or without streams and threads."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.bullet
THREADS = """
import sys
import numpy as np
from concurrent.futures import ThreadPoolExecutor
import tb2rl

def drive(seed):
    env = tb2rl.make_env("maze", laser_noise=0.01)
    env.reset(seed=seed)
    actions = np.random.default_rng(seed).integers(3, size=10)
    poses = [env.step(action)[4]["pose"] for action in actions]
    env.close()
    sys.stdout.write(f"out {seed}\\n")  # a line at once
    sys.stderr.write(f"err {seed}\\n")
    return np.array(poses)

alone = [drive(seed) for seed in range(16)]
for _ in range(4):
    with ThreadPoolExecutor(8) as pool:
        for one, two in zip(alone, pool.map(drive, range(16)), strict=True):
            np.testing.assert_array_equal(one, two)
print("alive")
"""


PRINTS = """
import tb2rl
print("before", end=" ")
env = tb2rl.make_env()
env.reset(seed=0)
env.step(0)
env.camera()
env.close()
print("after")
"""
WITHOUT_STREAMS = """
import os, sys
{loss}
import tb2rl
env = tb2rl.make_env()
env.reset(seed=0)
env.step(0)
env.close()
os._exit(7)
"""


def run(script):
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)


def test_nothing_is_printed_and_nothing_of_the_user_is_lost():
    done = run(PRINTS)
    assert (done.stdout, done.stderr) == ("before after\n", "")


@pytest.mark.slow
def test_environments_in_threads_drive_as_alone_and_lose_no_line():
    done = run(THREADS)
    expected = sorted([str(seed) for seed in range(16)] * 5)
    assert sorted(line.split()[1] for line in done.stdout.splitlines()[:-1]) == expected
    assert done.stdout.endswith("alive\n")
    assert sorted(line.removeprefix("err ") for line in done.stderr.splitlines()) == expected


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["sys.stdout = sys.stderr = None", "os.close(0); os.close(1); os.close(2)"])
def test_it_works_without_streams(loss):
    done = subprocess.run([sys.executable, "-c", WITHOUT_STREAMS.replace("{loss}", loss)], check=False)
    assert done.returncode == 7
