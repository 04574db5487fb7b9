"""A policy with bounded means: noise always changes its actions."""

import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy

from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.config import config_from, resolve
from tb2rl.training.policies import BoundedPolicy

OBSERVATIONS, ACTIONS = spaces.Box(0.0, 1.0, (3,)), spaces.Box(-1.0, 1.0, (2,))


@pytest.fixture
def far_below():
    """A function that makes a policy whose last layer returns -5 for both actions."""

    def make(policy_type):
        policy = policy_type(OBSERVATIONS, ACTIONS, lambda _: 1e-3, log_std_init=-2.0)
        with th.no_grad():
            [bias] = [p for name, p in policy.named_parameters() if "action_net" in name and name.endswith("bias")]
            bias.fill_(-5.0)
        return policy

    return make


def share_of_clipped_actions(policy) -> float:
    actions, _, _ = policy(th.zeros(1000, 3))
    return (actions <= -1.0).float().mean().item()


def test_noise_changes_an_action_at_its_limit(far_below):
    assert share_of_clipped_actions(far_below(ActorCriticPolicy)) == 1.0, "noise has no effect, so nothing is learned"
    assert 0.4 < share_of_clipped_actions(far_below(BoundedPolicy)) < 0.6
    greedy, _ = far_below(BoundedPolicy).predict(OBSERVATIONS.sample(), deterministic=True)
    assert greedy == pytest.approx([-1.0, -1.0], abs=1e-3)


def test_the_optimiser_trains_all_parameters(far_below):
    policy = far_below(BoundedPolicy)
    trained = {id(parameter) for group in policy.optimizer.param_groups for parameter in group["params"]}
    assert trained == {id(parameter) for parameter in policy.parameters()}


def test_discrete_actions_are_not_bounded():
    policy = BoundedPolicy(OBSERVATIONS, spaces.Discrete(3), lambda _: 1e-3)
    assert isinstance(policy.action_net, th.nn.Linear)


def test_it_is_a_setting_that_a_run_keeps():
    policy = "tb2rl.training.policies:BoundedPolicy"
    config = resolve("ppo", "drive", settings={"agent.policy": policy, "train.n_envs": 2})
    assert config.to_dict()["agent"]["policy"] == policy
    assert type(make_algorithm(config_from(config.to_dict())).policy) is BoundedPolicy
