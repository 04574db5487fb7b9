"""Normalized trainings, and their policies, which take raw observations outside of them."""

import copy
import json
import pickle
import re
from contextlib import closing

import cloudpickle
import numpy as np
import pytest
import stable_baselines3
import torch as th
from stable_baselines3.common.vec_env import VecNormalize

from tb2rl import evaluate, load, make_env
from tb2rl.commands.convert import export_policy
from tb2rl.core.errors import InputError
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.evaluation.evaluate import VALIDATION_SEED
from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import parse_settings
from tb2rl.simulation.simulator import default_physics
from tb2rl.training.training import train_config

SMALL = {"agent.policy_kwargs.net_arch": [16], "task.observation": "raw"}
ON_POLICY = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 2, **SMALL}
OFF_POLICY = {"agent.learning_starts": 32, "agent.buffer_size": 200, "agent.batch_size": 16, **SMALL}
BOTH = {"norm_obs": True, "norm_reward": True}
TRAININGS = {
    "PPO, an image": ("stable_baselines3:PPO", "my_tasks:Pictured", {**ON_POLICY, "task.frame_stack": 2}),
    "SAC": ("stable_baselines3:SAC", "drive", {**OFF_POLICY, "train.eval_simulation": default_physics().name}),
    "RecurrentPPO": ("sb3_contrib:RecurrentPPO", "drive", {**ON_POLICY, "agent.policy_kwargs.lstm_hidden_size": 8}),
}


@pytest.fixture(scope="module", params=TRAININGS)
def run(request, small, tmp_path_factory):
    """A short normalized training of each kind, with evaluations."""
    agent, task, settings = TRAININGS[request.param]
    evaluations = {"eval_freq": 64, "eval_episodes": 2, "eval_steps": 15}
    config = small(agent, task, settings, episode_steps=20, **evaluations, **BOTH)
    return train_config(config, tmp_path_factory.mktemp("normalised") / "run").run


def observations_of(policy):
    """Raw observations of one environment."""
    with closing(make_env(policy, simulation="kinematic")) as env:
        seen = [env.reset(seed=1)[0]]
        env.action_space.seed(1)
        return [*seen, *(env.step(env.action_space.sample())[0] for _ in range(3))]


def test_a_loaded_policy_normalizes_as_the_environments_of_its_training(run):
    file = run.policy_file
    policy, content = load(file), read_checkpoint(file)
    theirs = make_algorithm(run.config)
    theirs.policy.load_state_dict({key: th.from_numpy(value) for key, value in content["policy"].items()})
    env = theirs.get_vec_normalize_env()
    for name, saved in content["normalisation"]["observations"].items():
        met = env.obs_rms[name] if isinstance(env.obs_rms, dict) else env.obs_rms
        met.mean, met.var = saved["mean"], saved["var"]
        assert saved["count"] > 60
    once = pickle.loads(cloudpickle.dumps(policy.policy))
    predictors = [each.predict for each in (policy, policy.policy, once, copy.deepcopy(once))]
    for observation in observations_of(policy):
        wanted = theirs.predict(env.normalize_obs(observation), deterministic=True)[0]
        for predict in predictors:
            np.testing.assert_array_equal(predict(observation, deterministic=True)[0], wanted)


@pytest.mark.parametrize("run", ["SAC"], indirect=True)
def test_evaluations_while_training_are_those_of_the_loaded_policy(run):
    lines = (run.folder / "evaluations.jsonl").read_text().splitlines()
    noted = [line for line in map(json.loads, lines) if line["best"]][-1]
    policy = load(run.folder / "best" / "policy.safetensors")
    simulation = run.config.train.eval_simulation
    here = evaluate(policy, episodes=2, steps=15, seed=VALIDATION_SEED, workers=1, simulation=simulation)
    summary = json.loads(json.dumps(here.summary()))
    assert {name: noted[name] for name in summary} == summary
    assert policy.num_timesteps == noted["timesteps"]


def test_returns_are_discounted_as_the_agent_does_and_logged_as_they_are(small):
    settings = {**ON_POLICY, "agent.gamma": 0.5}
    config = small("stable_baselines3:PPO", "maze", settings, **BOTH)
    scene = config.scene.with_time_limit(4)
    with closing(TurtleBot2VecEnv(scene, config.train.n_envs, reward_scale=0.5)) as inner:
        env = make_algorithm(config, inner).get_vec_normalize_env()
        assert (env.gamma, env.norm_obs, env.norm_reward, env.training) == (0.5, True, True, True)
        env.seed(0)
        env.reset()
        total = np.zeros(4)
        for _ in range(4):
            _, rewards, _, infos = env.step(np.zeros(4, int))
            assert not np.allclose(rewards, env.get_original_reward())
            total += env.get_original_reward() / 0.5
        assert [info["episode"]["r"] for info in infos] == total.tolist()


@pytest.mark.parametrize(
    ("agent", "task", "settings"),
    [("qlearn", "maze", {}), ("stable_baselines3:PPO", "my_tasks:OnlyPicture", ON_POLICY)],
    ids=["classes", "image"],
)
def test_classes_and_images_are_not_normalised(agent, task, settings, small, tmp_path):
    config = small(agent, task, settings, norm_obs=True)
    with pytest.raises(InputError, match=r"train\.norm_obs normalises numbers, but the observations are"):
        train_config(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_inverse_range_is_refused_and_the_advice_works(small, tmp_path):
    settings = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 1}
    with pytest.raises(InputError, match="InverseRange, which needs ranges in metres") as refused:
        train_config(small("ppo", settings=settings, norm_obs=True), tmp_path / "refused")
    advice = parse_settings(re.findall(r"agent\.\S+=\S+", str(refused.value)))
    assert len(advice) == 2
    train_config(small("ppo", settings=settings | advice, norm_obs=True), tmp_path / "run")


@pytest.mark.parametrize("run", ["PPO, an image"], indirect=True)
def test_a_zip_for_stable_baselines3_comes_with_its_statistics(run, tmp_path):
    policy = load(run.folder)
    files = export_policy(run.folder, tmp_path / "it.zip")
    assert files == [tmp_path / "it.zip", tmp_path / "it-vecnormalize.pkl"]
    theirs = stable_baselines3.PPO.load(files[0])
    env = VecNormalize.load(files[1], make_algorithm(run.config).env.venv)
    assert not env.training
    for observation in observations_of(policy):
        wanted = theirs.predict(env.normalize_obs(observation), deterministic=True)[0]
        np.testing.assert_array_equal(policy.predict(observation, deterministic=True)[0], wanted)
