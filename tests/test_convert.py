"""Policies go to Stable-Baselines3 and come back; loading a zip executes code, and only `--trust` does it."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import stable_baselines3
from stable_baselines3 import DQN, PPO
from torch import nn

from tb2rl import convert, load, make_env
from tb2rl.runs.config import resolve
from tb2rl.training.training import train_config

TINY = {"train.simulation": "kinematic", "train.n_envs": 2, "train.total_timesteps": 64, "train.eval_freq": 0}
GLIDE = """
from dataclasses import dataclass

from tb2rl.tasks import Outcome, Task, Velocities

@dataclass(frozen=True)
class Glide(Task):
    actions = Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0))

    def outcome(self, before, action, after):
        return Outcome(after.twist[:, 0], failed={"bump": after.bumped})
"""


def assert_same_actions(policies, expected) -> None:
    observations = np.stack([expected.observation_space.sample() for _ in range(50)])
    actions = expected.predict(observations, deterministic=True)[0]
    for policy in policies:
        np.testing.assert_array_equal(policy.predict(observations, deterministic=True)[0], actions)


@pytest.mark.parametrize(
    ("agent", "name", "task", "settings"),
    [
        ("dqn", "DQN", "maze", {}),
        pytest.param("ppo", "PPO", "maze", {"agent.n_steps": 16, "agent.batch_size": 32}, marks=pytest.mark.slow),
        ("stable_baselines3:SAC", "SAC", "glide:Glide", {"agent.buffer_size": 100, "agent.use_sde": True}),
    ],
)
def test_an_exported_policy_opens_in_its_library_and_comes_back(agent, name, task, settings, module_folder, capsys):
    (module_folder / "glide.py").write_text(GLIDE)
    settings = {**TINY, **settings, "task.observation": "raw"}
    train_config(resolve(agent, task, settings=settings), Path("run"))
    convert.main(["run", "policy.zip"])
    ours, theirs = load("run"), getattr(stable_baselines3, name).load("policy.zip")
    more = ["--agent", agent, "--task", task, "--set", "task.observation=raw"]
    convert.main(["--trust", "policy.zip", "back", *more])
    back = load("back")
    assert_same_actions([theirs, back], ours)
    assert (back.num_timesteps, back.use_sde) == (ours.num_timesteps, ours.use_sde)
    assert "back" in capsys.readouterr().out


def test_a_network_of_another_shape_is_imported(workdir):
    env = make_env("maze", "raw", simulation="kinematic", beams=9)
    model = PPO("MlpPolicy", env, n_steps=64, policy_kwargs={"net_arch": [16], "activation_fn": nn.ELU})
    model.save("mine.zip")
    convert.main(["--trust", "mine.zip", "run", "--agent", "ppo", "--set", "task.beams=9"])
    assert_same_actions([load("run")], model)


@pytest.fixture(scope="module")
def policy_zip(tmp_path_factory):
    file = tmp_path_factory.mktemp("zip") / "policy.zip"
    DQN("MlpPolicy", make_env("maze", "raw", simulation="kinematic"), buffer_size=10).save(file)
    return file


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--trust {zip} new", ["--agent"]),
        ("--trust {zip} new --agent random", ["random", "does not learn"]),
        ("--trust {zip} new --agent ppo", ["policy.zip", "stable_baselines3:PPO"]),
        ("--trust {zip} new --agent dqn --set task.beams=9", ["the policy has the observation space"]),
        ("zoo:maze-loop-dqn new --agent dqn", ["--agent is for a local zip with --trust"]),
        ("zoo:maze-loop-dqn /proc/none/x.zip", ["cannot write", "/proc/none"]),
    ],
)
def test_wrong_input_is_refused(line, named, policy_zip, refused):
    refused(convert.main, line.format(zip=policy_zip), named)


class Payload:
    """Code of an attacker in a zip: here it makes a folder."""

    def __reduce__(self):
        return Path.mkdir, (Path("executed"),)


def test_without_trust_the_code_in_a_zip_is_not_executed(policy_zip, workdir, refused):
    with zipfile.ZipFile(policy_zip) as old, zipfile.ZipFile("evil.zip", "w") as new:
        for name in old.namelist():
            new.writestr(name, pickle.dumps(Payload()) if name == "policy.pth" else old.read(name))
    refused(convert.main, "evil.zip new", ["--trust", "code"])
