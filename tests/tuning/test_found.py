"""A whole search: from poor settings to good ones, although it is killed in between."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from tb2rl.evaluation.evaluator import PASSED
from tb2rl.runs.layers import resolve
from tb2rl.tuning.selection import compare
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.study import StudyFolder
from tb2rl.tuning.trials import best_trials

CHECKOUT = Path(__file__).parents[2]
TRIALS, WORKERS = 30, 2
TRAIN = {"simulation": "kinematic", "total_timesteps": 1_000_000, "eval_episodes": 300, "eval_steps": 500}
_SUBREAPER = 36  # of prctl: processes whose parent is killed become ours, so that their time is counted


def poor_preset(seed: int) -> dict:
    """Settings of qlearn that hardly learn, each drawn from where it does harm."""
    rng = np.random.default_rng(seed)
    rate = float(10 ** rng.uniform(-3.5, -2.5))
    agent = {
        "name": "qlearn",
        "learning_rate": {"start": rate, "end": rate / 10},
        "gamma": float(rng.uniform(0.2, 0.5)),
        "averaging": float(10 ** rng.uniform(-3.5, -3)),
        "exploration_fraction": 1.0,
        "exploration_final_eps": float(rng.uniform(0.7, 0.95)),
    }
    return {"agent": agent, "train": TRAIN}


@pytest.fixture
def time_counted():
    """A function to the seconds of processors that the processes of this one took since, their own ones included."""
    libc = ctypes.CDLL(None)
    libc.prctl(_SUBREAPER, 1)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)

    def seconds() -> float:
        time.sleep(2.0)  # servers of processes end once they see that nobody needs them
        while True:  # those that are ours now, and have ended
            try:
                if os.waitpid(-1, os.WNOHANG)[0] == 0:
                    break
            except ChildProcessError:
                break
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        return now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime

    yield seconds
    libc.prctl(_SUBREAPER, 0)


def tune() -> subprocess.Popen:
    words = f"--preset poor.yaml --name found --trials {TRIALS} --workers {WORKERS} --fresh 0".split()
    command = [sys.executable, "-m", "tb2rl.tune", *words]
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(CHECKOUT)})


def trials(folder: StudyFolder, *states: str) -> dict[int, tuple]:
    with open_study(folder) as study:
        return {
            trial.number: (trial.state, trial.value, trial.params)
            for trial in study.trials
            if trial.state.name in states
        }


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the time of lost processes is counted by Linux's means")
def test_a_search_from_poor_settings_finds_good_ones_although_it_is_killed(tmp_path, monkeypatch, time_counted):
    monkeypatch.chdir(tmp_path)
    Path("poor.yaml").write_text(yaml.safe_dump(poor_preset(seed=1)))
    killed, folder, started = tune(), Path("runs/tune/found"), time.monotonic()
    while not (folder / "study.db").is_file():
        assert killed.poll() is None
        time.sleep(0.2)
    study_folder = StudyFolder.open(folder)
    while len(trials(study_folder, "COMPLETE", "PRUNED")) < 10:
        assert killed.poll() is None
        time.sleep(1.0)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    time.sleep(1.0)  # for its processes to see it
    before = trials(study_folder, "COMPLETE", "PRUNED")
    assert tune().wait() == 0
    after = trials(study_folder, "COMPLETE", "PRUNED")
    assert {number: after[number] for number in before} == before
    assert len(after) == TRIALS
    assert len(trials(study_folder, "FAIL")) <= WORKERS
    assert trials(study_folder, "RUNNING") == {}
    seconds = time_counted()
    print(f"{seconds:.0f} s of processors, {time.monotonic() - started:.0f} s")
    assert seconds / 2 < 300
    best = yaml.safe_load((folder / "best.yaml").read_text())
    with open_study(study_folder) as study:
        found = next(
            trial for trial in best_trials(study, 3) if study_folder.preset(study_folder.settings(trial.params)) == best
        )
    assert resolve(preset=str(folder / "best.yaml")) == study_folder.config(study_folder.settings(found.params), seed=0)
    comparison = compare(study_folder, "best", study_folder.settings(found.params), 3)
    print(comparison)
    assert min(comparison.rates) >= PASSED


def test_the_poor_settings_are_poor_in_what_is_searched():
    tree, space = poor_preset(seed=1), yaml.safe_load((CHECKOUT / "configs/tuning/qlearn.yaml").read_text())
    for key, entry in space.items():
        value: object = tree
        for name in key.split("."):
            value = value[name]
        assert not entry["low"] <= value < entry["high"]
