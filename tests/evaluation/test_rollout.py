"""A rollout is what the environment does with a policy: the same steps, the same figures, nothing left out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise

import numpy as np
import pytest
import torch as th

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.evaluation.rollout import roll_out
from tb2rl.runs.algorithm import Spaces, make_algorithm, make_baseline
from tb2rl.runs.layers import resolve


@pytest.fixture
def env() -> Iterator:
    with closing(make_env("maze", start="fixed", episode_steps=100)) as env:
        yield env


def test_a_rollout_is_the_drive_of_the_environment(env, ahead):
    moments = list(roll_out(env, ahead, seed=3))
    env.reset(seed=3)
    total, steps, over = 0.0, 0, False
    while not over:
        _, reward, terminated, truncated, info = env.step(0)
        total, steps, over = total + reward, steps + 1, terminated or truncated
    last = moments[-1]
    assert (last.step, last.total, last.info["ended"]) == (steps, total, info["ended"])
    assert (last.info["ended"], last.info["failed"]) == ("collision", True)
    assert last.info["distance"] == info["distance"]
    assert (last.pose == info["pose"]).all()
    assert [moment.info["ended"] for moment in moments[:-1]] == [""] * (steps - 1)
    assert [moment.step for moment in moments] == list(range(1, steps + 1))
    assert all((after.before == before.pose).all() for before, after in pairwise(moments))


def test_it_begins_where_it_is_told(env, ahead):
    first = next(roll_out(env, ahead, seed=0, pose=np.array([1.0, 4.4, 0.5])))
    assert first.before.tolist() == [1.0, 4.4, 0.5]
    with pytest.raises(InputError, match="inside a wall"):
        next(roll_out(env, ahead, seed=0, pose=np.array([0.0, 0.0, 0.0])))


def test_each_moment_says_how_its_episode_began(northward, ahead):
    with closing(make_env(northward, episode_steps=2)) as env:
        first, second = (list(roll_out(env, ahead, seed=seed)) for seed in (0, 1))
    for moments in (first, second):
        assert moments[0].initial_state.table.tolist() == moments[1].initial_state.table.tolist()
        assert moments[0].initial_state.pose[0].tolist() == moments[0].before.tolist()
    assert (first[0].initial_state.goal != second[0].initial_state.goal).all()


def test_the_actions_are_those_that_the_policy_gave(env, ahead, cruise):
    assert {moment.action.shape for moment in roll_out(env, ahead, seed=0)} == {()}
    config = resolve("random", cruise, settings={"task.episode_steps": 5})
    with closing(make_env(cruise, episode_steps=5)) as cruising:
        actions = [moment.action for moment in roll_out(cruising, make_baseline(config), seed=0)]
    assert {action.shape for action in actions} == {(2,)}
    assert len({tuple(action.tolist()) for action in actions}) == 5
    assert np.abs(actions).max() <= 1.0


def test_a_policy_that_draws_draws_the_same_again_and_leaves_the_stream_alone(env):
    policy = make_baseline(resolve("random"))
    th.manual_seed(7)
    expected = th.rand(3).tolist()
    th.manual_seed(7)
    drives = [[int(moment.action) for moment in roll_out(env, policy, seed)] for seed in (1, 1, 2)]
    assert th.rand(3).tolist() == expected
    assert drives[0] == drives[1] != drives[2]


def test_a_recurrent_policy_gets_back_what_it_remembers(env):
    class Counting:
        def __init__(self) -> None:
            self.given: list[object] = []

        def predict(self, observation, *, deterministic=False, state=None):
            assert deterministic
            self.given.append(state)
            return np.int64(1), (state or 0) + 1

    policy = Counting()
    for _ in range(2):
        moments = roll_out(env, policy, seed=0)
        for _ in range(4):
            next(moments)
    assert policy.given == [None, 1, 2, 3] * 2, "an episode begins without memories"


@pytest.fixture
def remembering():
    """A network with a memory, without training, whose actions depend on what it remembers."""
    settings = {"task.observation": "raw", "train.n_envs": 1, "agent.policy_kwargs.lstm_hidden_size": 8}
    config = resolve("sb3_contrib:RecurrentPPO", settings=settings)
    policy = make_algorithm(config, Spaces.vectorised(config)).policy
    th.manual_seed(5)  # one that does not run into the next wall
    for parameter in (*policy.lstm_actor.parameters(), *policy.action_net.parameters()):
        th.nn.init.normal_(parameter)
    return policy


def test_a_network_with_a_memory_drives_as_stable_baselines_lets_it(remembering):
    with closing(make_env("maze", "raw", episode_steps=60)) as env:
        driven = [int(moment.action) for moment in roll_out(env, remembering, seed=5)]
        observation, _ = env.reset(seed=5)
        expected, forgotten, memory, over = [], [], None, False
        while not over:
            forgotten.append(int(remembering.predict(observation, deterministic=True)[0]))
            begins = np.array([memory is None])
            action, memory = remembering.predict(observation, memory, episode_start=begins, deterministic=True)
            expected.append(int(action))
            observation, _, terminated, truncated, _ = env.step(action)
            over = terminated or truncated
    assert driven == expected
    assert driven[0] == forgotten[0]
    assert driven != forgotten, "what it remembers makes a difference"


def test_an_action_that_does_not_exist_is_refused(env):
    class Confused:
        def predict(self, observation, *, deterministic=False):
            return np.int64(3), None

    with pytest.raises(InputError, match="is not one of the integers 0 to 2"):
        next(roll_out(env, Confused(), seed=0))
