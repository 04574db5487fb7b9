"""A Minari dataset: episodes with infos are recorded, stored and read back unchanged."""

import gc
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

import tb2rl

minari = pytest.importorskip("minari", reason="minari is not installed")
pytest.importorskip("h5py", reason="h5py is not installed (minari[hdf5])")
pytest.importorskip("jax", reason="jax is not installed (minari[create])")


# Minari warns about missing metadata.
ABOUT = {
    "algorithm_name": "random",
    "author": "Ada",
    "author_email": "ada@example.org",
    "code_permalink": "https://example.org/collect.py",
    "description": "A few short episodes.",
    "requirements": ["tb2rl"],
    "eval_env": "TurtleBot2Maze-v0",
}


@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")  # of Minari's folder
@pytest.mark.parametrize(
    "make",
    [
        partial(gym.make, "tb2rl:TurtleBot2Maze-v0", max_episode_steps=12),
        partial(tb2rl.make_env, "maze", "raw", episode_steps=12, simulation="kinematic"),
    ],
)
def test_a_dataset_returns_the_recorded_episodes(make, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = make()
    collector = minari.DataCollector(env, record_infos=True)
    driven = [drive(collector, seed) for seed in range(3)]
    made = collector.create_dataset("turtlebot2/maze/test-v0", **ABOUT)
    collector.close()
    del collector
    gc.collect()  # Minari's folder is removed by the garbage collector
    assert made.total_episodes == 3

    dataset = minari.load_dataset("turtlebot2/maze/test-v0")
    for episode, (observations, actions, rewards, infos) in zip(dataset.iterate_episodes(), driven, strict=True):
        np.testing.assert_array_equal(episode.observations, observations)
        np.testing.assert_array_equal(episode.actions, actions)
        np.testing.assert_array_equal(episode.rewards, rewards)
        assert episode.infos.keys() == infos[0].keys()
        for key, values in episode.infos.items():
            stored = [value.decode() if isinstance(value, bytes) else value for value in values]
            np.testing.assert_array_equal(stored, [info[key] for info in infos])
        assert [info["ended"] for info in infos[:-1]] == [""] * len(actions)
        assert infos[-1]["ended"] in ("time limit", "collision")
    again = dataset.recover_environment()
    np.testing.assert_array_equal(again.reset(seed=0)[0], driven[0][0][0])
    assert again.spec.max_episode_steps == again.unwrapped.task.episode_steps == 12
    again.close()


def drive(env, seed):
    """An episode: its observations, actions, rewards and infos."""
    env.action_space.seed(seed)
    observation, info = env.reset(seed=seed)
    observations, actions, rewards, infos = [observation], [], [], [info]
    while not info["ended"]:
        actions.append(env.action_space.sample())
        observation, reward, _, _, info = env.step(actions[-1])
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
    return observations, actions, rewards, infos
