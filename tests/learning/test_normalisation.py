"""Normalised trainings: what they learn from, and policies that take observations as they are, wherever they drive."""

from __future__ import annotations

import copy
import json
import pickle

import cloudpickle
import numpy as np
import pytest
import stable_baselines3
import torch as th
from stable_baselines3.common.vec_env import VecNormalize

from tb2rl import evaluate, load, make_env
from tb2rl.commands.convert import export_policy
from tb2rl.errors import InputError
from tb2rl.judging.evaluator import TRAINING_SEED
from tb2rl.learning.environments import make_vec_env
from tb2rl.learning.training import train_config
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.normalisation import driving_policy, normalised
from tb2rl.showing.action_map import action_map

SMALL = {"agent.policy_kwargs.net_arch": [16], "task.observation": "raw"}
ON_POLICY = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 2, **SMALL}
OFF_POLICY = {"agent.learning_starts": 32, "agent.buffer_size": 200, "agent.batch_size": 16, **SMALL}
BOTH = {"norm_obs": True, "norm_reward": True}
TRAININGS = {
    "PPO": ("stable_baselines3:PPO", "maze", ON_POLICY),
    "PPO, frames": ("stable_baselines3:PPO", "maze", {**ON_POLICY, "task.frames": 3}),
    "PPO, an image beside": ("stable_baselines3:PPO", "my_tasks:Pictured", {**ON_POLICY, "task.frames": 2}),
    "SAC": ("stable_baselines3:SAC", "my_tasks:Glide", OFF_POLICY),
    "DQN, an image beside": ("stable_baselines3:DQN", "my_tasks:Pictured", OFF_POLICY),
    "RecurrentPPO": (
        "sb3_contrib:RecurrentPPO",
        "my_tasks:Glide",
        {**ON_POLICY, "agent.policy_kwargs.lstm_hidden_size": 8},
    ),
}


@pytest.fixture(scope="module", params=TRAININGS)
def run(request, small, tmp_path_factory):
    """A short training of each kind, normalised, with evaluations on the way."""
    agent, task, settings = TRAININGS[request.param]
    evaluations = {"eval_freq": 64, "eval_episodes": 2, "eval_steps": 15}
    config = small(agent, task, settings, episode_steps=20, **evaluations, **BOTH)
    return train_config(config, tmp_path_factory.mktemp("normalised") / "run").run


def observations_of(policy, steps=12):
    """What one robot observes on a drive, as the environment gives it."""
    env = make_env(policy, simulation="kinematic")
    seen = [env.reset(seed=1)[0]]
    env.action_space.seed(1)
    seen += [env.step(env.action_space.sample())[0] for _ in range(steps)]
    env.close()
    return seen


def test_a_loaded_policy_normalises_as_the_environments_of_its_training_did(run):
    file = run.policy_file
    policy, content = load(file), read_checkpoint(file)
    theirs = make_algorithm(run.config, Spaces.vectorised(run.config))
    theirs.policy.load_state_dict({key: th.from_numpy(value) for key, value in content["policy"].items()})
    env = theirs.get_vec_normalize_env()
    assert isinstance(env, VecNormalize)
    for name, saved in content["normalisation"]["observations"].items():
        met = env.obs_rms[name] if isinstance(env.obs_rms, dict) else env.obs_rms
        met.mean, met.var = saved["mean"], saved["var"]
        assert saved["count"] > 60
    ways = [policy.predict, policy.policy.predict]
    once = pickle.loads(cloudpickle.dumps(policy.policy))
    ways += [once.predict, pickle.loads(cloudpickle.dumps(once)).predict, copy.deepcopy(once).predict]
    for observation in observations_of(policy):
        wanted = theirs.predict(env.normalize_obs(observation), deterministic=True)[0]
        for predict in ways:
            np.testing.assert_array_equal(predict(observation, deterministic=True)[0], wanted)
