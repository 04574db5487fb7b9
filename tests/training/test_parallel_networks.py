"""The actor and the critic run at the same time, and learn what they learn one after the other, to the bit."""

import threading

import pytest

from tb2rl.training import parallel_networks, training
from tb2rl.training.training import resume, train_config

SETTINGS = {"agent.n_steps": 8, "agent.batch_size": 128, "agent.n_epochs": 2}


@pytest.fixture
def in_parallel(monkeypatch):
    """Lets all networks run in parallel, however small they are; returns the threads in which they have run."""
    threads, each = set(), parallel_networks._each

    def noted(function, *arguments):
        def call(*args):
            threads.add(threading.get_ident())
            return function(*args)

        return each(call, *arguments)

    monkeypatch.setattr("tb2rl.core.threads.THREADS", 2)
    monkeypatch.setattr(parallel_networks, "processors", lambda: 4)
    monkeypatch.setattr(parallel_networks, "_MIN_MULTIPLICATIONS", 1)
    monkeypatch.setattr(parallel_networks, "_each", noted)
    return threads


@pytest.mark.parametrize("agent", ["ppo", "stable_baselines3:A2C"])
def test_networks_learn_the_same_at_the_same_time(agent, in_parallel, small, assert_same_runs, tmp_path, monkeypatch):
    settings = SETTINGS if agent == "ppo" else {"agent.n_steps": 8}
    config = small(agent, settings=settings, n_envs=64, total_timesteps=2048)
    parallel = train_config(config, tmp_path / "parallel").run
    assert len(in_parallel) == 2
    monkeypatch.setattr(training, "parallelize_networks", lambda algorithm: None)
    assert_same_runs(parallel, train_config(config, tmp_path / "alone").run)


def test_equal_threads_give_equal_runs_also_after_a_resume(
    in_parallel, small, killed, assert_same_runs, tmp_path, monkeypatch
):
    monkeypatch.setattr("tb2rl.runs.config.processors", lambda: 4)
    train = {"n_envs": 64, "total_timesteps": 2048, "save_freq": 1024, "torch_threads": "auto"}
    one, other = (train_config(small("ppo", settings=SETTINGS, **train), tmp_path / name).run for name in "ab")
    assert_same_runs(one, other)
    resumed = killed(one, tmp_path / "killed")
    assert resumed.config.train.torch_threads == 2, "half the processors, as a number"
    monkeypatch.setattr("tb2rl.runs.config.processors", lambda: 1)
    assert_same_runs(one, resume(resumed.folder).run)
