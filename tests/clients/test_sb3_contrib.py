"""Algorithms of sb3-contrib, built by hand on the environment that `gymnasium.make` gives."""

import gymnasium as gym
import numpy as np
import pytest

sb3_contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")

SMALL = {"net_arch": [16]}
ON_POLICY = {"n_steps": 64, "batch_size": 32}
ALGORITHMS = {
    "QRDQN": ("MlpPolicy", {"learning_starts": 50, "buffer_size": 1000, "policy_kwargs": {**SMALL, "n_quantiles": 10}}),
    "TRPO": ("MlpPolicy", {**ON_POLICY, "policy_kwargs": SMALL}),
    "RecurrentPPO": ("MlpLstmPolicy", {**ON_POLICY, "policy_kwargs": {**SMALL, "lstm_hidden_size": 8}}),
}


@pytest.fixture
def env():
    env = gym.make("tb2rl:TurtleBot2MazeRaw-v0", simulation="kinematic", max_episode_steps=60)
    yield env
    env.close()


@pytest.mark.parametrize("name", ALGORITHMS)
def test_an_algorithm_learns_is_saved_and_drives_with_its_state(name, env, tmp_path):
    policy, settings = ALGORITHMS[name]
    model = getattr(sb3_contrib, name)(policy, env, seed=0, **settings)
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(256)
    assert any(not old.equal(new) for old, new in zip(before, model.policy.parameters(), strict=True))
    assert {episode["l"] for episode in model.ep_info_buffer} <= set(range(1, 61))
    assert len(model.ep_info_buffer) >= 256 // 60

    model.save(tmp_path / "model")
    again = type(model).load(tmp_path / "model", env=env)
    assert actions_of(model, env) == actions_of(again, env)


def actions_of(model, env):
    """What the model does in an episode, its state handed on as users of recurrent policies do."""
    observation, info = env.reset(seed=5)
    state, start, actions = None, np.array([True]), []
    while not info["ended"]:
        action, state = model.predict(observation, state=state, episode_start=start, deterministic=True)
        start = np.array([False])
        observation, _, _, _, info = env.step(action)
        actions.append(int(action))
    return actions
