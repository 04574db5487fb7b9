"""A rollout is an episode of the environment, control step by control step."""

from __future__ import annotations

from contextlib import closing
from itertools import islice, pairwise

import numpy as np
import pytest
import torch as th

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.evaluation.moments import roll_out
from tb2rl.runs.algorithm import Spaces, make_algorithm, make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.simulation import InitialState


@pytest.fixture
def env():
    with closing(make_env("maze", start="fixed", episode_steps=100, simulation="kinematic")) as env:
        yield env


@pytest.mark.parametrize("simulation", ["kinematic", "bullet"])
def test_a_rollout_is_an_episode_of_the_environment(simulation, forward):
    with closing(make_env("maze", episode_steps=100, simulation=simulation)) as env:
        moments = list(roll_out(env.loop, forward, seed=3))
        env.reset(seed=3)
        rewards, infos = [], []
        while not infos or not infos[-1]["ended"]:
            _, reward, _, _, info = env.step(0)
            rewards.append(reward)
            infos.append(info)
    assert [moment.reward for moment in moments] == rewards
    assert [moment.info["ended"] for moment in moments] == [info["ended"] for info in infos]
    assert [moment.after.pose[0].tolist() for moment in moments] == [info["pose"].tolist() for info in infos]
    assert [moment.step for moment in moments] == list(range(1, len(infos) + 1))
    assert all((after.before.pose == before.after.pose).all() for before, after in pairwise(moments))
    last = moments[-1]
    assert (last.total, last.info["distance"]) == (sum(rewards), infos[-1]["distance"])
    assert (last.info["ended"], last.info["failed"]) == ("collision", True)


def test_a_rollout_starts_from_the_given_initial_state(env, forward):
    initial_state = InitialState.default(env.scene.spec, 1)
    initial_state.pose[:] = 1.0, 4.4, 0.5
    first = next(roll_out(env.loop, forward, 0, initial_state))
    assert first.before.pose.tolist() == first.initial_state.pose.tolist() == [[1.0, 4.4, 0.5]]


def test_moments_hold_the_random_initial_state_of_their_episode(northward, forward):
    with closing(make_env(northward, episode_steps=2, simulation="kinematic")) as env:
        first, second = (list(roll_out(env.loop, forward, seed)) for seed in (0, 1))
    for moments in (first, second):
        assert moments[0].initial_state.table.tolist() == moments[1].initial_state.table.tolist()
        assert moments[0].initial_state.pose.tolist() == moments[0].before.pose.tolist()
    assert (first[0].initial_state.goal != second[0].initial_state.goal).all()


def test_actions_are_those_of_the_policy(env, forward, cruise):
    assert {moment.action.shape for moment in roll_out(env.loop, forward, seed=0)} == {()}
    config = resolve("random", cruise, settings={"task.episode_steps": 5})
    with closing(make_env(cruise, episode_steps=5, simulation="kinematic")) as cruising:
        actions = [moment.action for moment in roll_out(cruising.loop, make_baseline(config), seed=0)]
    assert {action.shape for action in actions} == {(2,)}
    assert len({tuple(action.tolist()) for action in actions}) == 5


def test_random_actions_depend_on_the_seed_and_leave_the_generator_of_torch_alone(env):
    policy = make_baseline(resolve("random"))
    th.manual_seed(7)
    expected = th.rand(3).tolist()
    th.manual_seed(7)
    actions = [[int(moment.action) for moment in roll_out(env.loop, policy, seed)] for seed in (1, 1, 2)]
    assert th.rand(3).tolist() == expected
    assert actions[0] == actions[1] != actions[2]


def test_a_recurrent_policy_starts_each_episode_without_state(env):
    class Counting:
        def __init__(self) -> None:
            self.given: list[object] = []

        def predict(self, observation, *, deterministic=False, state=None):
            assert deterministic
            self.given.append(state)
            return np.int64(1), (state or 0) + 1

    policy = Counting()
    for _ in range(2):
        list(islice(roll_out(env.loop, policy, seed=0), 4))
    assert policy.given == [None, 1, 2, 3] * 2


def test_a_recurrent_network_acts_as_with_stable_baselines():
    settings = {"task.observation": "raw", "train.n_envs": 1, "agent.policy_kwargs.lstm_hidden_size": 8}
    config = resolve("sb3_contrib:RecurrentPPO", settings=settings)
    policy = make_algorithm(config, Spaces.vectorised(config)).policy
    th.manual_seed(5)  # drives on for a while
    for parameter in (*policy.lstm_actor.parameters(), *policy.action_net.parameters()):
        th.nn.init.normal_(parameter)
    with closing(make_env("maze", "raw", episode_steps=60, simulation="kinematic")) as env:
        driven = [int(moment.action) for moment in roll_out(env.loop, policy, seed=5)]
        observation, _ = env.reset(seed=5)
        expected, stateless, state, over = [], [], None, False
        while not over:
            stateless.append(int(policy.predict(observation, deterministic=True)[0]))
            starts = np.array([state is None])
            action, state = policy.predict(observation, state, episode_start=starts, deterministic=True)
            expected.append(int(action))
            observation, _, terminated, truncated, _ = env.step(action)
            over = terminated or truncated
    assert driven == expected
    assert driven != stateless, "its state makes a difference"


def test_an_action_that_does_not_exist_is_refused(env):
    class Confused:
        def predict(self, observation, *, deterministic=False):
            return np.int64(3), None

    with pytest.raises(InputError, match="is not one of the integers 0 to 2"):
        next(roll_out(env.loop, Confused(), seed=0))
