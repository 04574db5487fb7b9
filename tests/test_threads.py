"""Threads that share the work of many environments: all of it is done, errors are raised, processes can fork."""

import subprocess
import sys

import numba
import numpy as np
import pytest

from tb2rl.core import threads
from tb2rl.core.threads import MIN_PARALLEL_TIME, parallel_for, parallel_if_long


@pytest.mark.parametrize(("count", "number", "lead"), [(1, 5, 0), (10, 1, 7), (1001, 5, 7), (1001, 2, 5000)])
def test_every_part_is_done_once(count, number, lead, monkeypatch):
    monkeypatch.setattr(threads, "THREADS", number)
    done = np.zeros(count, int)

    def work(first, last, amount):
        done[first:last] += amount

    parallel_for(work, count, lead, 3)
    assert (done == 3).all()


def test_only_long_work_is_divided(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 3)
    for item_time, number in ((0.9 * MIN_PARALLEL_TIME / 1000, 1), (1.1 * MIN_PARALLEL_TIME / 1000, 3)):
        parts = []
        parallel_if_long(lambda first, end, parts: parts.append((first, end)), 1000, item_time, parts)
        assert len(parts) == number
        assert sum(end - first for first, end in parts) == 1000


def test_an_error_in_any_part_is_raised(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 2)
    for wrong in (0, 5):
        with pytest.raises(ZeroDivisionError):
            parallel_for(lambda first, last, wrong=wrong: 1 / (first - wrong), 10, 0)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(threads.os, "fork"), reason="this system does not fork")
def test_a_process_forked_after_a_step_of_many_environments_can_step_without_openmp():
    """Threads of OpenMP would spin while they wait, unless imported in the right order, and die in forked processes."""
    script = """
import os
import torch, numba, numpy as np, gymnasium as gym
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
numba.threading_layer()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "ValueError: Threading layer is not initialized."
    assert numba.config.NUMBA_NUM_THREADS >= 1
