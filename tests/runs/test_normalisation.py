"""Statistics from a file: those of the policy's own training, or refused in one line."""

import pytest

from tb2rl.runs.config import resolve
from tb2rl.runs.loading import load
from tb2rl.training.training import train_config

SETTINGS = {
    "agent.n_steps": 16,
    "agent.batch_size": 32,
    "agent.n_epochs": 1,
    "agent.policy_kwargs.net_arch": [8],
    "train.simulation": "kinematic",
    "train.n_envs": 4,
    "train.total_timesteps": 64,
    "train.eval_freq": 0,
    "train.norm_obs": True,
    "train.norm_reward": True,
}


@pytest.fixture(scope="module")
def policy_file(tmp_path_factory):
    """A policy that normalises; not to be changed."""
    config = resolve("stable_baselines3:PPO", settings=SETTINGS)
    return train_config(config, tmp_path_factory.mktemp("normalised") / "run").run.policy_file


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        ("normalisation", ..., "normalisation"),
        ("normalisation/observations/numbers/mean", lambda mean: mean[:-1], "numbers.mean"),
    ],
)
def test_statistics_that_do_not_fit_are_refused(place, value, said, policy_file, edited, refused, tmp_path):
    file = edited(policy_file, tmp_path / "policy.safetensors", place, value)
    message = refused(load, file)
    assert message.startswith(f"{file} contradicts its config")
    assert said in message
