"""The numbers from which every kind of policy chooses its action."""

import numpy as np
import pytest

from tb2rl.core import agent_names, find_agent
from tb2rl.runs import resolve
from tb2rl.runs.algorithm import make_algorithm, make_baseline
from tb2rl.viz.viewer.policy_values import COMMAND, policy_values

LEARNING = [name for name in agent_names() if find_agent(name).algorithm]


@pytest.mark.parametrize("name", LEARNING)
def test_the_action_of_a_policy_is_that_of_its_values(name):
    pytest.importorskip(find_agent(name).algorithm.split(".")[0].split(":")[0])
    continuous = find_agent(name).actions == "continuous"
    config = resolve(name, "drive" if continuous else "maze")
    algorithm, scene = make_algorithm(config), config.scene
    observation = scene.observation_space.sample()
    found = policy_values(algorithm, observation, scene.actions)
    if "recurrent" in name:
        assert found is None
        return
    action = algorithm.predict(observation, deterministic=True)[0]
    if continuous:
        assert found.meaning == COMMAND
        assert list(found.scores.values()) == pytest.approx(scene.actions.commands(np.array([action]))[0], abs=1e-5)
    else:
        assert list(found.scores) == list(scene.actions.names)
        assert max(found.scores, key=found.scores.get) == scene.actions.names[int(action)]
    assert np.isfinite(found.value)


def test_probabilities_add_up_to_one():
    config = resolve("ppo", "maze")
    found = policy_values(make_algorithm(config), config.scene.observation_space.sample(), config.scene.actions)
    assert sum(found.scores.values()) == pytest.approx(1.0)


def test_a_critic_that_observes_privileged_sensors_has_no_value_without_them():
    policy = {"agent.policy": "tb2rl.training.policies:AsymmetricPolicy", "train.privileged": ["bumper"]}
    config = resolve("ppo", "drive", settings=policy)
    found = policy_values(make_algorithm(config).policy, config.scene.observation_space.sample(), config.scene.actions)
    assert found.meaning == COMMAND
    assert np.isnan(found.value)


def test_a_policy_that_computes_none_has_none():
    config = resolve("wallfollower", "maze")
    assert policy_values(make_baseline(config), config.scene.observation_space.sample(), config.scene.actions) is None
