"""Threads that share the work of a batch: every part is done once, errors arrive, processes can be forked."""

import subprocess
import sys

import numba
import numpy as np
import pytest

from tb2rl.simulation import threads
from tb2rl.simulation.kinematic.threads import parallel_for


@pytest.mark.parametrize("count", [1, 2, 10, 1001])
@pytest.mark.parametrize("number", [1, 2, 5])
@pytest.mark.parametrize("lead", [0, 7, 5000])
def test_every_part_is_done_once(count, number, lead, monkeypatch):
    monkeypatch.setattr(threads, "THREADS", number)
    done = np.zeros(count, int)

    def work(first, last, amount):
        done[first:last] += amount

    parallel_for(work, count, lead, 3)
    assert (done == 3).all()


def test_an_error_in_any_part_arrives(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 2)
    for wrong in (0, 5):
        with pytest.raises(ZeroDivisionError):
            parallel_for(lambda first, last, wrong=wrong: 1 / (first - wrong), 10, 0)


@pytest.mark.skipif(not hasattr(threads.os, "fork"), reason="this system does not fork")
def test_a_process_that_is_forked_after_a_large_batch_drives_on():
    script = """
import os
import numpy as np
import gymnasium as gym
env = gym.make_vec("tb2rl:TurtleBot2Maze-v0", num_envs=4096, simulation="kinematic")
env.reset(seed=0)
actions = np.zeros(4096, int)
env.step(actions)
child = os.fork()
poses = env.step(actions)[4]["pose"]
if child == 0:
    os._exit(40 + int(abs(poses.sum())) % 10)
status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
assert status == 40 + int(abs(poses.sum())) % 10, status
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_no_thread_of_openmp_is_started():
    """They spin while they wait, unless libraries are imported in the right order, and die in forked processes."""
    script = """
import torch, numba, numpy as np, gymnasium as gym
env = gym.make_vec("tb2rl:TurtleBot2Maze-v0", num_envs=4096, simulation="kinematic")
env.reset(seed=0)
env.step(np.zeros(4096, int))
numba.threading_layer()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "Threading layer is not initialized" in done.stderr
    assert numba.config.NUMBA_NUM_THREADS >= 1
