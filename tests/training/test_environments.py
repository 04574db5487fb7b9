"""The environments of a training: which kind they are, what they report, and their state."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.training.environments import make_vec_env, restore, state_of

KINDS = {  # simulation, environments
    "twin": ("kinematic", 3),
    "alone": ("bullet", 1),
    "processes": ("bullet", 3),
}


@pytest.fixture(params=KINDS)
def env(request, small):
    """Environments of each kind, with episodes of four steps and rewards that are halved."""
    simulation, environments = KINDS[request.param]
    config = small(
        settings={"task.laser_noise": 0.01, "task.start_clearance": 0.8},
        simulation=simulation,
        n_envs=environments,
        episode_steps=4,
        reward_scale=0.5,
    )
    with closing(make_vec_env(config)) as env:
        assert env.num_envs == environments
        env.seed(3)
        env.reset()
        yield env


def test_an_episode_that_ends_is_reported_with_its_unscaled_return(env):
    total = np.zeros(env.num_envs)
    for step in range(1, 5):
        _, rewards, dones, infos = env.step(np.zeros(env.num_envs, dtype=int))
        total += rewards
        assert dones.tolist() == [step == 4] * env.num_envs
    for info, halved in zip(infos, total, strict=True):
        assert info["episode"] == {"r": 2.0 * halved, "l": 4, "t": 0.0}
        assert (info["ended"], info["failed"], info["TimeLimit.truncated"]) == ("time limit", False, True)
        assert info["terminal_observation"] in env.observation_space
    assert 2.0 * total[0] == 4 * 5.0


def from_a_file(state, folder):
    """The state as a checkpoint brings it."""
    write_checkpoint(folder / "state.safetensors", {"state": state})
    return read_checkpoint(folder / "state.safetensors")["state"]


def test_the_state_brings_back_everything_that_follows(env, tmp_path):
    rng = np.random.default_rng(0)
    actions = rng.integers(3, size=(12, env.num_envs))
    for action in actions[:2]:  # within an episode
        env.step(action)
    state = from_a_file(state_of(env), tmp_path)
    ways = []
    for _ in range(2):
        ways.append([[values.copy() for values in env.step(action)[:3]] for action in actions])
        restore(env, state)
    for one, other in zip(*ways, strict=True):
        for values, again in zip(one, other, strict=True):
            np.testing.assert_array_equal(values, again)


def test_a_state_of_other_environments_is_refused(env, small, tmp_path):
    simulation = "bullet" if isinstance(env.batch.simulation, KinematicSimulator) else "kinematic"
    with closing(make_vec_env(small(simulation=simulation, n_envs=env.num_envs))) as other:
        other.seed(0)
        other.reset()
        with pytest.raises(ValueError, match="environments"):
            restore(env, from_a_file(state_of(other), tmp_path))
    with closing(make_vec_env(small(n_envs=env.num_envs + 1))) as other:
        other.seed(0)
        other.reset()
        with pytest.raises(ValueError, match="environments"):
            restore(env, from_a_file(state_of(other), tmp_path))
