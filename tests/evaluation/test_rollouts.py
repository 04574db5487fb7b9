"""A rollout is an episode of the environment, control step by control step."""

from contextlib import closing
from itertools import islice, pairwise

import numpy as np
import pytest
import torch as th

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.evaluation.episodes import roll_out
from tb2rl.runs.algorithm import make_algorithm, make_baseline
from tb2rl.runs.config import resolve


@pytest.fixture
def env():
    with closing(make_env("maze", start="fixed", episode_steps=100, simulation="kinematic")) as env:
        yield env


@pytest.mark.parametrize("simulation", ["kinematic", "bullet", "mujoco"])
def test_a_rollout_is_an_episode_of_the_environment(simulation, forward):
    with closing(make_env("maze", episode_steps=100, simulation=simulation)) as env:
        steps = list(roll_out(env.loop, forward, seed=3))
        env.reset(seed=3)
        rewards, infos = [], []
        while not infos or not infos[-1]["ended"]:
            _, reward, _, _, info = env.step(0)
            rewards.append(reward)
            infos.append(info)
    assert [step.reward for step in steps] == rewards
    assert [step.info["ended"] for step in steps] == [info["ended"] for info in infos]
    assert [step.after.pose[0].tolist() for step in steps] == [info["pose"].tolist() for info in infos]
    assert [step.number for step in steps] == list(range(1, len(infos) + 1))
    assert {step.action.shape for step in steps} == {()}
    assert all((after.before.pose == before.after.pose).all() for before, after in pairwise(steps))
    assert (steps[-1].episode_return, steps[-1].info["distance"]) == (sum(rewards), infos[-1]["distance"])
    assert (infos[-1]["ended"], steps[-1].info["failed"]) == ("collision", True)


def test_steps_hold_the_random_initial_state_of_their_episode(northward, forward):
    with closing(make_env(northward, episode_steps=2, simulation="kinematic")) as env:
        (first, second), (other, _) = (list(roll_out(env.loop, forward, seed)) for seed in (0, 1))
    assert first.after.initial_state.table.tolist() == second.after.initial_state.table.tolist()
    assert first.after.initial_state.pose.tolist() == first.before.pose.tolist()
    assert (first.after.initial_state.goal != other.after.initial_state.goal).all()


def test_random_actions_depend_on_the_seed_and_leave_the_generator_of_torch_alone(env):
    policy = make_baseline(resolve("random"))
    th.manual_seed(7)
    expected = th.rand(3).tolist()
    th.manual_seed(7)
    actions = [[int(step.action) for step in roll_out(env.loop, policy, seed)] for seed in (1, 1, 2)]
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
    policy = make_algorithm(config).policy
    th.manual_seed(5)  # drives on for a while
    for parameter in (*policy.lstm_actor.parameters(), *policy.action_net.parameters()):
        th.nn.init.normal_(parameter)
    with closing(make_env("maze", "raw", episode_steps=60, simulation="kinematic")) as env:
        driven = [int(step.action) for step in roll_out(env.loop, policy, seed=5)]
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
