"""The algorithm that a config describes: made by the registry, refused in one line, small enough for the memory."""

import pytest
import torch as th
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy

from tb2rl.runs.algorithm import make_algorithm, make_baseline
from tb2rl.runs.config import resolve
from tb2rl.training.training import train_config

SB3 = "stable_baselines3"


def make(agent, **settings):
    given = {key.replace("__", "."): value for key, value in settings.items()}
    config = resolve(agent, settings={"task.observation": "raw", "train.n_envs": 4, **given})
    return make_algorithm(config)


def test_it_is_made_with_its_settings():
    algorithm = make("ppo", agent__gamma=0.5, train__seed=9, agent__policy_kwargs={"net_arch": [8]})
    assert type(algorithm).__name__ == "PPO"
    assert (algorithm.gamma, algorithm.seed, algorithm.n_envs) == (0.5, 9, 4)
    assert algorithm.policy.net_arch == [8]
    assert (algorithm.observation_space.shape, algorithm.action_space.n) == ((36,), 3)


def test_equal_seeds_make_equal_algorithms():
    one, again, other = (make("dqn", train__seed=seed).policy.state_dict() for seed in (1, 1, 2))
    assert all(th.equal(value, again[name]) for name, value in one.items())
    assert not all(th.equal(value, other[name]) for name, value in one.items())


@pytest.mark.parametrize(("more", "reader"), [([], "NatureCNN"), (["laser", "twist"], "CombinedExtractor")])
def test_the_camera_preset_undoes_what_the_agents_preset_says_of_numbers(more, reader):
    observe = [{"camera": {"width": 48, "height": 40}}, *more]
    config = resolve("ppo", preset="camera", settings={"task.observe": observe, "train.n_envs": 8})
    algorithm = make_algorithm(config)
    assert type(algorithm.policy.features_extractor).__name__ == reader


@pytest.mark.parametrize("agent", ["random", "wallfollower"])
def test_an_agent_that_does_not_learn_is_a_policy_alone(agent, refused):
    config = resolve(agent)
    policy = make_baseline(config)
    assert policy.action_space == config.scene.action_space
    assert policy.predict(config.scene.observation_space.sample())[0] in config.scene.action_space
    assert f"agent {agent} does not learn" in refused(make_algorithm, config, None)


def test_an_agent_that_learns_is_not_a_policy_alone(refused):
    assert "agent dqn learns" in refused(make_baseline, resolve("dqn"))


# ---- what is refused


class Unsaved(ActorCriticPolicy):
    """Its weights are arrays of another library than torch, which `state_dict` does not know."""

    def state_dict(self):
        return {}


def test_an_algorithm_without_parameters_that_can_be_saved_is_refused_before_there_is_a_run_folder(
    refused, tmp_path, monkeypatch
):
    monkeypatch.setattr(PPO, "policy_aliases", {"MlpPolicy": Unsaved})
    config = resolve(f"{SB3}:PPO", settings={"train.simulation": "kinematic", "train.eval_freq": 0})
    message = refused(train_config, config, tmp_path / "run")
    assert f"agent {SB3}:PPO cannot be saved: its Unsaved has no torch parameters" in message
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("agent", "settings"),
    [
        ("ppo", {"agent__n_steps": 0}),
        ("ppo", {"agent__batch_size": 1}),
        ("dqn", {"agent__optimize_memory_usage": True}),
        (f"{SB3}:SAC", {}),  # which needs continuous actions
        ("ppo", {"agent__use_sde": True}),  # which needs them, too
        (f"{SB3}.common.off_policy_algorithm:OffPolicyAlgorithm", {}),
    ],
    ids=str,
)
@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size:UserWarning")
def test_what_a_library_refuses_is_one_line_that_names_the_settings(agent, settings, refused):
    message = refused(make, agent, **settings)
    assert f"agent {agent} with raw observations rejects its settings" in message
    assert [key for key in settings if key.removeprefix("agent__") not in message] == []


@pytest.mark.parametrize(
    ("agent", "task", "learns", "has"),
    [("qlearn", "drive", "discrete", "continuous"), ("td3", "my-maze", "continuous", "discrete")],
)
def test_an_agent_that_cannot_do_the_actions_of_a_task_is_refused(agent, task, learns, has, refused):
    message = refused(make_algorithm, resolve(agent, task), None)
    assert message == f"agent {agent} learns {learns} actions; those of task {task} are {has}"


def test_an_algorithm_that_wants_masks_of_actions_is_refused(refused):
    assert "agent sb3_contrib:MaskablePPO needs action masks" in refused(make, "sb3_contrib:MaskablePPO")


@pytest.mark.parametrize("device", ["nowhere", "cpu:x"])
def test_a_device_that_cannot_be_used_is_refused(device, refused):
    assert "train.device" in refused(make, "ppo", train__device=device)


def test_a_network_that_memory_does_not_hold_is_refused(refused):
    assert "rejects its settings" in refused(make, "ppo", agent__policy_kwargs={"net_arch": [10**6, 10**8]})
