"""Algorithms of sb3-contrib, constructed directly on the environment of `gymnasium.make`."""

import gymnasium as gym
import numpy as np
import pytest

sb3_contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")

SETTINGS = {
    "TRPO": ("MlpPolicy", {"policy_kwargs": {"net_arch": [16]}}),
    "RecurrentPPO": ("MlpLstmPolicy", {"policy_kwargs": {"net_arch": [16], "lstm_hidden_size": 8}}),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_an_algorithm_learns_is_saved_and_drives_with_its_state(name, tmp_path):
    env = gym.make("tb2rl:TurtleBot2MazeRaw-v0", simulation="kinematic", max_episode_steps=60)
    policy, settings = SETTINGS[name]
    model = getattr(sb3_contrib, name)(policy, env, seed=0, n_steps=64, batch_size=64, **settings)
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(128)
    assert any(not old.equal(new) for old, new in zip(before, model.policy.parameters(), strict=True))
    assert {episode["l"] for episode in model.ep_info_buffer} <= set(range(1, 61))
    assert len(model.ep_info_buffer) >= 128 // 60
    model.save(tmp_path / "model")
    again = type(model).load(tmp_path / "model", env=env)
    assert actions_of(model, env) == actions_of(again, env)
    env.close()


def actions_of(model, env):
    """The greedy actions of an episode, with the recurrent state passed on."""
    observation, info = env.reset(seed=5)
    state, start, actions = None, np.array([True]), []
    while not info["ended"]:
        action, state = model.predict(observation, state=state, episode_start=start, deterministic=True)
        start = np.array([False])
        observation, _, _, _, info = env.step(action)
        actions.append(int(action))
    return actions
