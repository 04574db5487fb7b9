"""The arguments of other people's algorithms: what their signatures take, and what their YAML form means."""

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from tb2rl.core.agent import Agent, find_agent
from tb2rl.envs.features import InverseRange
from tb2rl.runs.arguments import algorithm_arguments, checked_arguments, policy_class, with_policy

DQN, PPO, SAC = (Agent(f"stable_baselines3:{name}") for name in ("DQN", "PPO", "SAC"))
NEARNESS = "tb2rl.envs.features:InverseRange"
NAMED = spaces.Discrete(3)
LINE = {"start": 0.1, "end": 0.01}


@pytest.mark.parametrize(
    ("agent", "arguments"),
    [
        (DQN, {"gamma": 0.9, "train_freq": [4, "step"], "learning_rate": LINE}),
        (PPO, {"clip_range": {**LINE, "fraction": 0.5}, "target_kl": None, "normalize_advantage": False}),
        (SAC, {"ent_coef": "auto_0.1", "use_sde": True, "policy_kwargs": {"log_std_init": -1.0}}),
        (PPO, {"policy_kwargs": {"net_arch": {"pi": [8], "vf": [8, 8]}, "activation_fn": "torch.nn:ELU"}}),
        (PPO, {"policy_kwargs": {"features_extractor_class": NEARNESS, "features_extractor_kwargs": {"middle": 0.5}}}),
        (DQN, {"policy_kwargs": {"optimizer_class": "torch.optim:SGD", "optimizer_kwargs": {"momentum": 0.9}}}),
        (find_agent("wallfollower"), {"side": 0.7}),
    ],
    ids=str,
)
def test_what_a_signature_knows_is_taken(agent, arguments):
    assert checked_arguments(agent, arguments).keys() == arguments.keys()


@pytest.mark.parametrize(
    ("agent", "arguments", "named"),
    [
        (DQN, {"gama": 0.9}, ["agent", "'gama'", "did you mean 'gamma'", "learning_rate"]),
        (DQN, {"gamma": "high"}, ["agent.gamma", "number", "'high'"]),
        (DQN, {"gamma": LINE}, ["agent.gamma"]),
        (DQN, {"learning_rate": {**LINE, "fraction": 0}}, ["agent.learning_rate.fraction", "greater than 0"]),
        (DQN, {"learning_rate": {**LINE, "strat": 1}}, ["agent.learning_rate", "'strat'", "did you mean 'start'"]),
        (DQN, {"seed": 1}, ["'seed'"]),
        (PPO, {"policy_kwargs": {"net_arc": [8]}}, ["agent.policy_kwargs", "'net_arc'", "did you mean 'net_arch'"]),
        (PPO, {"policy_kwargs": {"activation_fn": "torch.nn:Elu"}}, ["activation_fn", "has no 'Elu'"]),
        (PPO, {"policy_kwargs": {"activation_fn": "os:system"}}, ["activation_fn", "neither a torch module"]),
        (
            PPO,
            {"policy_kwargs": {"features_extractor_class": NEARNESS, "features_extractor_kwargs": {"midle": 1}}},
            ["agent.policy_kwargs.features_extractor_kwargs", "did you mean 'middle'"],
        ),
        (find_agent("qlearn"), {"gamma": 1.5}, ["agent.gamma", "less than or equal to 1", "1.5"]),
        (find_agent("wallfollower"), {"sid": 1.0}, ["'sid'", "did you mean 'side'"]),
        (find_agent("td3"), {"action_noise": {"sigma": -0.1}}, ["action_noise.sigma", "-0.1"]),
        (find_agent("sac"), {"action_noise": 0.1}, ["agent.action_noise", "expected a mapping", "0.1"]),
    ],
    ids=str,
)
def test_what_it_does_not_know_is_refused(agent, arguments, named, refused):
    message = refused(checked_arguments, agent, arguments)
    assert [part for part in named if part not in message] == [], message


def test_a_schedule_becomes_a_line_over_the_remaining_training():
    line = {"learning_rate": {"start": 0.5, "end": 0.1, "fraction": 0.8}}
    rate = algorithm_arguments(line, NAMED)["learning_rate"]
    assert [rate(remaining) for remaining in (1.0, 0.6, 0.2, 0.0)] == pytest.approx([0.5, 0.3, 0.1, 0.1])


def test_classes_in_policy_kwargs_are_imported():
    kwargs = {"activation_fn": "torch.nn:ELU", "features_extractor_class": NEARNESS}
    made = algorithm_arguments({"policy_kwargs": {**kwargs, "net_arch": [8]}, "gamma": 0.9}, NAMED)
    classes = {"activation_fn": th.nn.ELU, "features_extractor_class": InverseRange}
    assert made == {"policy_kwargs": {**classes, "net_arch": [8]}, "gamma": 0.9}


def test_action_noise_is_a_normal_distribution_for_every_number_of_an_action():
    assert checked_arguments(find_agent("td3"), {"action_noise": {"sigma": 0.2}}) == {"action_noise": {"sigma": 0.2}}
    made = algorithm_arguments({"action_noise": {"sigma": 0.2}}, spaces.Box(-1.0, 1.0, (2,)))["action_noise"]
    drawn = np.array([made() for _ in range(2000)])
    assert drawn.std(axis=0) == pytest.approx([0.2, 0.2], rel=0.1)
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("policy", "named"),
    [
        ("MlpPolicies", ["agent.policy", "did you mean 'MlpPolicy'"]),
        ("tb2rl.training.policies:Unbounded", ["agent.policy", "has no 'Unbounded'"]),
        ("tb2rl.envs.scene:Scene", ["agent.policy", "neither a torch module"]),
    ],
)
def test_an_unknown_policy_is_refused(policy, named, refused):
    message = refused(policy_class, with_policy(PPO, spaces.Box(0.0, 1.0, (3,)), policy))
    assert [part for part in named if part not in message] == [], message


def test_a_rule_has_no_other_policy(refused):
    rule = with_policy(find_agent("wallfollower"), spaces.Box(0.0, 1.0, (3,)), "MlpPolicy")
    assert rule == find_agent("wallfollower")
    assert "unknown key of agent 'policy'" in refused(checked_arguments, rule, {"policy": "MlpPolicy"})


def test_an_image_beside_numbers_needs_a_policy_that_reads_both():
    box = spaces.Box(0.0, 1.0, (3,))
    assert with_policy(find_agent("dqn"), box).policy == "MlpPolicy"
    assert with_policy(find_agent("dqn"), spaces.Dict(numbers=box)).policy == "MultiInputPolicy"
    assert with_policy(find_agent("qlearn"), spaces.Dict(numbers=box)).policy == "QTable"
    assert (
        with_policy(find_agent("sb3_contrib:RecurrentPPO"), spaces.Dict(numbers=box)).policy == "MultiInputLstmPolicy"
    )


@pytest.mark.parametrize(
    ("algorithm", "side", "policy"),
    [
        ("stable_baselines3:PPO", 36, "CnnPolicy"),
        ("stable_baselines3:PPO", 35, "MlpPolicy"),  # too small for the convolutions
        ("sb3_contrib:RecurrentPPO", 36, "CnnLstmPolicy"),
        ("sb3_contrib:CrossQ", 36, "MlpPolicy"),  # which has no other
    ],
)
def test_one_image_is_read_by_convolutions_where_there_are_some(algorithm, side, policy):
    assert with_policy(find_agent(algorithm), spaces.Box(0, 255, (1, 36, side), np.uint8)).policy == policy
