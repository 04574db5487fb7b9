"""Policies with bounded means, whose actions noise always changes, and with a critic that observes more."""

import re

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy

from tb2rl import InputError, evaluate, make_env, train
from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.config import config_from, resolve
from tb2rl.training.policies import BoundedPolicy
from tb2rl.training.training import resume

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


PRIVILEGED = {
    "task.world": "wall",
    "task.goal": [1.5, 0.0],
    "train.simulation": "kinematic",
    "train.n_envs": 2,
    "agent.n_steps": 16,
    "agent.batch_size": 32,
    "train.privileged": ["waypoint", "path_length"],
    "agent.policy": "tb2rl.training.policies:AsymmetricPolicy",
}


def test_only_the_critic_observes_privileged_sensors():
    config = resolve("ppo", "navigate", settings=PRIVILEGED)
    algorithm = make_algorithm(config)
    policy, space = algorithm.policy, algorithm.observation_space
    observations = th.as_tensor(np.tile(space.sample(), (2, 1)))
    observations[1, -3:] += 1.0
    assert space.names[-3:] == ("waypoint", "waypoint", "path length")
    assert policy.observation_space == config.scene.observation_space
    means = policy.get_distribution(observations[:, :-3]).mode()
    actions, values, _ = policy(observations, deterministic=True)
    assert th.equal(actions[0], actions[1])
    assert th.allclose(actions, means)
    assert values[0] != values[1]
    assert th.equal(values, policy.predict_values(observations))
    assert policy.predict_values(observations[:, :-3]).isnan().all(), "a value needs the privileged numbers"


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"agent.policy": "MlpPolicy"}, "train.privileged needs agent.policy=tb2rl.training.policies:AsymmetricPolicy"),
        ({"train.privileged": ["waypiont"]}, "unknown sensor of train.privileged: 'waypiont'"),
        ({"task.frame_stack": 2}, "train.privileged needs task.observation=raw without images, and task.frame_stack=1"),
        ({"train.norm_obs": True}, "train.norm_obs does not work with train.privileged"),
        ({"train.privileged": ["camera"]}, "train.privileged: images are no numbers"),
    ],
)
def test_what_does_not_fit_is_one_line(settings, problem):
    with pytest.raises(InputError, match=re.escape(problem)):
        make_algorithm(resolve("ppo", "navigate", settings={**PRIVILEGED, **settings}))


def test_a_trained_policy_needs_no_privileged_sensors(tmp_path):
    counts = {"total_timesteps": 64, "eval_freq": 32, "eval_episodes": 2, "eval_steps": 5}
    policy = train("ppo", "navigate", folder=tmp_path / "run", settings=PRIVILEGED, **counts)
    env = make_env(policy, simulation="kinematic")
    observation, _ = env.reset(seed=0)
    assert policy.observation_space == env.observation_space
    assert policy.predict(observation)[0].shape == (2,)
    assert len(evaluate(policy, episodes=2, steps=5, simulation="kinematic").episodes) == 2
    assert resume(tmp_path / "run", total_timesteps=96).timesteps == 32
