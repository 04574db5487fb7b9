"""What the settings of a training change, and what they do not: seeds, processes, threads, rewards, time limits."""

from __future__ import annotations

import json
import re
from contextlib import nullcontext

import numpy as np
import pytest
import torch as th

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.training import training
from tb2rl.training.training import train_config

BULLET = {"simulation": "bullet", "total_timesteps": 300, "n_envs": 1}


def table(folder) -> np.ndarray:
    return load(folder / "final" / "policy.safetensors").policy.q.numpy()


@pytest.mark.parametrize("environments", [1, 3])
def test_equal_seeds_give_equal_tables_and_others_do_not(environments, small, tmp_path):
    for name, seed in (("one", 5), ("two", 5), ("other", 6)):
        train_config(small(seed=seed, **{**BULLET, "n_envs": environments}), tmp_path / name)
    np.testing.assert_array_equal(table(tmp_path / "one"), table(tmp_path / "two"))
    assert not np.array_equal(table(tmp_path / "one"), table(tmp_path / "other"))


def test_the_number_of_processors_changes_nothing_but_the_time(small, tmp_path, monkeypatch):
    for processors in (1, 3):
        monkeypatch.setattr("tb2rl.simulation.bullet_batch.processors", lambda n=processors: n)
        train_config(small(**{**BULLET, "n_envs": 3}), tmp_path / str(processors))
    np.testing.assert_array_equal(table(tmp_path / "1"), table(tmp_path / "3"))


@pytest.mark.parametrize(
    ("agent", "settings"), [("qlearn", {}), ("ppo", {"agent.n_steps": 5, "agent.batch_size": 500})]
)
def test_the_number_of_threads_changes_nothing_but_the_time(agent, settings, small, differences, tmp_path, monkeypatch):
    config = small(agent, settings=settings, n_envs=600, total_timesteps=6000)
    monkeypatch.setattr("tb2rl.simulation.kinematic.WORTH_THREADS", 0.0)
    ends = []
    for threads in (1, 3):
        monkeypatch.setattr("tb2rl.simulation.threads.THREADS", threads)
        run = train_config(config, tmp_path / str(threads)).run
        ends.append(read_checkpoint(run.checkpoints[0]))
    assert differences(*ends) == []


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_the_scale_of_the_reward_is_for_the_agent_alone(simulation, small, tmp_path, capsys):
    quick = {**BULLET, "simulation": simulation, "eval_freq": 150, "eval_episodes": 2, "eval_steps": 20}
    printed, noted = [], []
    for scale in (1.0, 0.5):  # powers of two leave every rounding as it is
        run = train_config(small(reward_scale=scale, **quick), tmp_path / str(scale), verbose=1).run
        printed.append(re.findall(r"Reward: (-?\d+) - Steps: (\d+)", capsys.readouterr().out))
        lines = (run.folder / "evaluations.jsonl").read_text().splitlines()
        noted.append([json.loads(line)["mean_return"] for line in lines])
    np.testing.assert_array_equal(table(tmp_path / "0.5"), 0.5 * table(tmp_path / "1.0"))
    assert printed[0] == printed[1] != []
    assert noted[0] == noted[1]


@pytest.mark.parametrize("environments", [1, 2])
def test_training_stops_after_the_episodes_that_were_asked_for(environments, small, tmp_path):
    settings = {**BULLET, "episodes": 5, "total_timesteps": 10**9, "n_envs": environments}
    done = train_config(small(**settings), tmp_path / "run")
    assert 5 <= len(done.lengths) <= 5 + environments - 1, "several environments may end an episode at once"
    assert environments * sum(done.lengths) >= done.timesteps >= sum(done.lengths)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_training_may_have_a_time_limit_of_its_own(simulation, small, tmp_path):
    config = small(**{**BULLET, "simulation": simulation, "episode_steps": 4})
    assert max(train_config(config, tmp_path / "run").lengths) == 4
    assert load(tmp_path / "run").trained_with.task.episode_steps > 4


@pytest.mark.parametrize("fails", [False, True])
def test_torch_gets_its_threads_back(fails, small, tmp_path, monkeypatch):
    during, before = [], th.get_num_threads()
    if fails:
        monkeypatch.setattr(training, "make_algorithm", lambda *_: during.append(th.get_num_threads()) or 1 / 0)
    else:
        make = training.make_algorithm
        monkeypatch.setattr(training, "make_algorithm", lambda *a: during.append(th.get_num_threads()) or make(*a))
    th.set_num_threads(3)
    try:
        with pytest.raises(ZeroDivisionError) if fails else nullcontext():
            train_config(small(torch_threads=2), tmp_path / "run")
        assert (during, th.get_num_threads()) == ([2], 3)
    finally:
        th.set_num_threads(before)


@pytest.mark.parametrize("device", ["cuda", "cuda:99", "mps"])
def test_a_device_that_is_not_there_trains_nothing_and_loads_all_the_same(device, small, tmp_path, monkeypatch):
    monkeypatch.setattr(th.cuda, "device_count", lambda: 0)
    monkeypatch.setattr(th.backends.mps, "is_available", lambda: False)
    config = small("stable_baselines3:A2C", device=device)
    run = Run.create(tmp_path / "run", config)
    run.save(make_algorithm(config, Spaces.vectorised(config)), "final/policy")  # as if another machine had trained it
    assert load(run.folder).device.type == "cpu"
    with pytest.raises(InputError, match=f"train.device '{device}' cannot be used: torch finds none"):
        train_config(config, tmp_path / "another")
    assert not (tmp_path / "another").exists()
