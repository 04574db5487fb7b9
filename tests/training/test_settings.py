"""Settings of a training: seeds, processes, threads, devices, rewards, time limits."""

import re

import numpy as np
import pytest
import torch as th

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.evaluation import evaluate
from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.folder import Run
from tb2rl.training import training
from tb2rl.training.training import train_config

BULLET = {"simulation": "bullet", "total_timesteps": 150, "n_envs": 3}


def table(folder) -> np.ndarray:
    return load(folder / "final" / "policy.safetensors").policy.q.numpy()


@pytest.mark.bullet
def test_equal_seeds_give_equal_tables_whatever_the_number_of_processes(small, tmp_path, monkeypatch):
    for name, seed, processors in (("one", 5, 1), ("two", 5, 3), ("other", 6, 1)):
        monkeypatch.setattr("tb2rl.simulation.bullet.batch.processors", lambda n=processors: n)
        train_config(small(seed=seed, **BULLET), tmp_path / name)
    np.testing.assert_array_equal(table(tmp_path / "one"), table(tmp_path / "two"))
    assert not np.array_equal(table(tmp_path / "one"), table(tmp_path / "other"))


def test_the_number_of_threads_changes_no_result(small, assert_same_runs, tmp_path, monkeypatch):
    config = small("ppo", settings={"agent.n_steps": 5, "agent.batch_size": 500}, n_envs=600, total_timesteps=3000)
    monkeypatch.setattr("tb2rl.core.threads.MIN_PARALLEL_TIME", 0.0)
    runs = []
    for threads in (1, 3):
        monkeypatch.setattr("tb2rl.core.threads.THREADS", threads)
        runs.append(train_config(config, tmp_path / str(threads)).run)
    assert_same_runs(*runs)


def test_only_the_agent_sees_scaled_rewards(small, evaluations, tmp_path, capsys):
    quick = {"n_envs": 1, "total_timesteps": 300, "eval_freq": 150, "eval_episodes": 2, "eval_steps": 20}
    printed, noted = [], []
    for scale in (1.0, 0.5):  # powers of two change no rounding
        run = train_config(small(reward_scale=scale, **quick), tmp_path / str(scale), verbose=1).run
        printed.append(re.findall(r"Reward: (-?\d+) - Steps: (\d+)", capsys.readouterr().out))
        noted.append([line["mean_return"] for line in evaluations(run)])
    np.testing.assert_array_equal(table(tmp_path / "0.5"), 0.5 * table(tmp_path / "1.0"))
    assert printed[0] == printed[1] != []
    assert noted[0] == noted[1]


@pytest.mark.parametrize("num_envs", [1, 2])
def test_a_training_stops_after_its_episodes(num_envs, small, tmp_path):
    done = train_config(small(episodes=5, total_timesteps=10**9, n_envs=num_envs), tmp_path / "run")
    assert 5 <= len(done.episode_lengths) <= 5 + num_envs - 1, "several environments may end an episode at once"
    assert num_envs * sum(done.episode_lengths) >= done.timesteps >= sum(done.episode_lengths)


def test_a_training_may_have_its_own_time_limit(small, tmp_path):
    assert max(train_config(small(episode_steps=4), tmp_path / "run").episode_lengths) == 4
    assert load(tmp_path / "run").trained_with.task.episode_steps > 4


def torchs_settings() -> tuple[int, str]:
    return th.get_num_threads(), th.get_float32_matmul_precision()


def test_torchs_settings_are_restored_after_a_training_that_failed(small, tmp_path, monkeypatch):
    during, before = [], torchs_settings()
    monkeypatch.setattr(training, "make_algorithm", lambda *_: during.append(torchs_settings()) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train_config(small(torch_threads=before[0] + 1, matmul_precision="medium"), tmp_path / "run")
    assert (during, torchs_settings()) == ([(before[0] + 1, "medium")], before)


def test_evaluations_compute_in_full_precision_whatever_the_training_does(small, tmp_path, monkeypatch):
    precisions, run_episodes = set(), evaluate.run_episodes

    def noted(*args, **kwargs):
        for episode in run_episodes(*args, **kwargs):
            precisions.add(th.get_float32_matmul_precision())
            yield episode

    monkeypatch.setattr(evaluate, "run_episodes", noted)
    train_config(small(matmul_precision="medium", eval_freq=64, eval_episodes=2, eval_steps=5), tmp_path / "run")
    assert precisions == {"highest"}


@pytest.mark.parametrize("device", ["cuda:99", "mps"])
def test_a_policy_trained_on_a_missing_device_loads_but_is_not_trained(device, small, tmp_path, monkeypatch):
    monkeypatch.setattr(th.cuda, "device_count", lambda: 0)
    monkeypatch.setattr(th.backends.mps, "is_available", lambda: False)
    config = small("stable_baselines3:A2C", device=device)
    run = Run.create(tmp_path / "run", config)
    run.save(make_algorithm(config), "final/policy")  # as if another machine had trained it
    assert load(run.folder).device.type == "cpu"
    with pytest.raises(InputError, match=f"train.device is '{device}', but torch finds no such device"):
        train_config(config, tmp_path / "another")
    assert not (tmp_path / "another").exists()
