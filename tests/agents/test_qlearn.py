"""Tabular Q-learning: the tutorial's algorithm by hand-computed numbers, and the textbook's."""

import math

import numpy as np
import pytest
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

from tb2rl.agents._qtable import Transitions, UpdateRule
from tb2rl.agents.qlearn import QLearning, update_table
from tb2rl.core.errors import InputError
from tb2rl.envs.make import make_env
from tb2rl.runs.config import resolve


@pytest.fixture
def values_after(drive):
    """Q of states 0 and 1 after some episodes, whose final state is worth 10."""

    def values(episodes: int, ends: str = "terminated", **arguments) -> list[float]:
        model = QLearning("QTable", drive(ends), learning_rate=0.1, gamma=0.7, **arguments)
        model.policy.q[2] = 10.0
        model.learn(2 * episodes)
        return model.policy.q[:2, 0].tolist()

    return values


@pytest.fixture
def action_shares(bandit):
    """The share of each action in a state of constant values."""

    def shares(values: list[float], epsilon: float, exploration="epsilon_greedy", steps: int = 20_000) -> np.ndarray:
        env = make_vec_env(lambda: bandit(len(values)), 50)
        rates = {"exploration_initial_eps": epsilon, "exploration_final_eps": epsilon, "exploration": exploration}
        model = QLearning("QTable", env, learning_rate=0.0, seed=0, **rates)
        model.policy.q[0] = model.policy.q.new_tensor(values)
        model.learn(steps)
        assert model.policy.q[0].tolist() == values
        return model.policy.visits[0].numpy() / steps

    return shares


# ---- the tutorial


def test_the_tutorial_preset_has_the_tutorials_numbers():
    config = resolve(preset="tutorial")
    assert (config.agent_name, config.task_name, config.observation) == ("qlearn", "maze", "discrete")
    arguments = dict(config.agent_arguments)
    assert arguments.pop("exploration_fraction") == 1.0, "exploration_decay replaces it"
    assert (config.train.episode_steps, config.train.stop_score) == (None, None)
    assert arguments == {
        "averaging": None,
        "learning_rate": 0.1,
        "gamma": 0.7,
        "exploration": "noisy_values",
        "exploration_initial_eps": 0.9,
        "exploration_final_eps": 0.05,
        "exploration_decay": 0.999,
        "update": "tutorial",
    }
    task, train = config.task, config.train
    assert task.actions.table.tolist() == [[0.5, 0.0], [0.05, 0.3], [0.05, -0.3]]
    rewards = (task.forward_reward, task.turn_reward, task.collision_reward)
    assert (rewards, task.collision_range) == ((5.0, 1.0, -200.0), 0.5)
    assert (task.beams, task.beam_indices, task.laser_noise, task.start) == (720, (0, 144, 288, 432, 576), 0.0, "fixed")
    assert (train.episodes, task.episode_steps, train.n_envs, train.reward_scale) == (500, 10_000, 1, 1.0)
    assert train.total_timesteps >= 500 * 10_000, "the episodes end the training, not the steps"


def test_the_tutorial_preset_observes_the_integer_part_of_the_ranges(make_robot_state):
    scene = resolve(preset="tutorial").scene
    assert np.degrees(scene.laser.angles) == pytest.approx([-90 + i * 180 / 719 for i in (0, 144, 288, 432, 576)])
    assert scene.observation_space.nvec.tolist() == [7] * 5
    for ranges, classes in (
        ((0.3, 0.99, 1.0, 1.99, 2.0), [0, 0, 1, 1, 2]),
        ((5.99, 6.0, 29.0, np.inf, np.nan), [5, 6, 6, 6, 0]),
    ):
        assert scene.encoding(make_robot_state(ranges=ranges))[0].tolist() == classes


def test_the_tutorials_first_visit_stores_the_reward_and_later_ones_bootstrap_also_through_a_collision(values_after):
    assert values_after(1, update="tutorial") == [5.0, -200.0]
    # 5 + 0.1 (5 + 0.7 * -200 - 5), and -200 + 0.1 (-200 + 0.7 * 10 + 200)
    assert values_after(2, update="tutorial") == pytest.approx([-9.0, -199.3])


def test_the_tutorials_epsilon_falls_at_the_start_of_each_episode(bandit, drive, epsilons):
    seen = epsilons(QLearning("QTable", bandit(), **resolve(preset="tutorial").agent_arguments), 3000)
    assert seen[:2] == pytest.approx([0.9 * 0.999, 0.9 * 0.999**2])
    assert seen[499] == pytest.approx(0.9 * 0.999**500)
    falls = math.ceil(math.log(0.05 / 0.9) / math.log(0.999))  # 2889: the first epsilon that is not above 0.05
    assert seen[falls - 2] > 0.05 >= seen[falls - 1]
    assert seen[-1] == seen[falls - 1] == pytest.approx(0.9 * 0.999**falls)
    model = QLearning("QTable", drive(), exploration_initial_eps=0.9, exploration_decay=0.5)
    assert epsilons(model, 5) == [0.45, 0.45, 0.225, 0.225, 0.1125], "an episode has two steps"


# The noise of two actions differs by less than the width w = max |q|, with a triangular density: the second best action
# wins with probability (1 - gap / w)^2 / 2.
@pytest.mark.parametrize(
    ("values", "epsilon", "share"),
    [
        ([10.0, 4.0], 1.0, 0.4**2 / 2),
        ([-10.0, -4.0], 1.0, 1 - 0.4**2 / 2),
        ([10.0, -0.1], 1.0, 0.0),
        ([10.0, 4.0], 0.5, 0.5 * 0.4**2 / 2),
    ],
)
def test_noisy_values_choose_by_the_gap_relative_to_the_largest_value(values, epsilon, share, action_shares):
    tolerance = 0.01 if share else 0.0
    assert action_shares(values, epsilon, "noisy_values")[1] == pytest.approx(share, abs=tolerance)


@pytest.mark.parametrize(
    ("exploration", "values", "shares"),
    [("noisy_values", [0.0, 0.0, 0.0], [1 / 3] * 3), ("epsilon_greedy", [2.0, 1.0, 2.0], [0.5, 0.0, 0.5])],
)
def test_ties_are_broken_at_random(exploration, values, shares, action_shares):
    assert action_shares(values, 0.0, exploration) == pytest.approx(shares, abs=0.015)


# ---- the textbook


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ("terminated", [0.5 + 0.1 * (5 + 0.7 * -20 - 0.5), -20 + 0.1 * (-200 + 20)]),
        ("truncated", [0.5 + 0.1 * (5 + 0.7 * -19.3 - 0.5), -19.3 + 0.1 * (-200 + 0.7 * 10 + 19.3)]),
    ],
)
def test_textbook_updates_bootstrap_at_a_time_limit_and_not_at_a_collision(ends, expected, values_after):
    assert values_after(2, ends=ends) == pytest.approx(expected)


@pytest.mark.parametrize("first_update_is_reward", [False, True])
def test_updates_of_one_pair_happen_one_after_the_other_and_so_do_their_averages(first_update_is_reward):
    rng = np.random.default_rng(0)
    states, reached = rng.integers(3, size=(2, 200))
    actions, ended, rewards = rng.integers(2, size=200), rng.random(200) < 0.2, rng.normal(size=200)
    q, averages, visits = np.zeros((3, 2)), np.zeros((3, 2)), np.zeros((3, 2), dtype=np.int64)
    transitions = Transitions(states, actions, rewards, reached, ended)
    update_table(q, averages, visits, transitions, UpdateRule(0.3, 0.9, first_update_is_reward, 0.05))

    expected, means, seen = np.zeros((3, 2)), np.zeros((3, 2)), np.zeros((3, 2), dtype=np.int64)
    for s, a, n, over, r in zip(states, actions, reached, ended, rewards, strict=True):
        target = r if over else r + 0.9 * max(expected[n])
        stores_reward = first_update_is_reward and seen[s, a] == 0
        expected[s, a] = r if stores_reward else expected[s, a] + 0.3 * (target - expected[s, a])
        seen[s, a] += 1
        share = max(0.05, 1 / seen[s, a])
        means[s, a] = (1 - share) * means[s, a] + share * expected[s, a]
    np.testing.assert_allclose(q, expected, rtol=1e-12)
    np.testing.assert_allclose(averages, means, rtol=1e-9)
    np.testing.assert_array_equal(visits, seen)


def test_epsilon_greedy_takes_a_random_action_at_the_rate_of_epsilon(action_shares):
    assert action_shares([1.0, 0.0, 0.5], 0.3) == pytest.approx([0.8, 0.1, 0.1], abs=0.01)


def test_epsilon_and_learning_rate_follow_their_schedules(bandit, epsilons):
    model = QLearning("QTable", bandit(), exploration_final_eps=0.2, exploration_fraction=0.5)
    seen = epsilons(model, 100)
    assert (seen[0], seen[25], seen[50], seen[99]) == pytest.approx((1.0, 0.6, 0.2, 0.2))
    model = QLearning("QTable", bandit(), learning_rate=lambda remaining: remaining, gamma=0.0)
    model.learn(4)  # alpha 0.75, 0.5, 0.25, 0 towards a reward of 1
    assert model.policy.q.item() == pytest.approx(1 - 0.25 * 0.5 * 0.75)


def test_it_learns_the_shortest_path_over_the_frozen_lake(frozen_lake):
    model = QLearning("QTable", frozen_lake(), learning_rate=0.5, gamma=0.9, seed=0).learn(10_000)
    returns, lengths = evaluate_policy(model, model.get_env(), n_eval_episodes=3, return_episode_rewards=True)
    assert (returns, lengths) == ([1.0] * 3, [6] * 3)
    assert model.policy.q[0].max().item() == pytest.approx(0.9**5), "the goal is six steps away"


def test_raw_observations_are_refused():
    with pytest.raises(InputError, match="observation=discrete"):
        QLearning("QTable", make_env(observation="raw"))


# ---- averages


def test_the_policy_acts_by_running_averages_of_the_values(drive):
    model = QLearning("QTable", drive("terminated"), learning_rate=0.5, gamma=0.0, averaging=0.4)
    model.learn(8)  # four episodes: state 1 is worth -200, and its values are -100, -150, -175, -187.5
    first_two = -100.0, (-100.0 - 150.0) / 2  # the first ones have equal weights
    third = first_two[1] + 0.4 * (-175.0 - first_two[1])
    assert model.policy.q[1, 0].item() == pytest.approx(third + 0.4 * (-187.5 - third))
    assert model._unaveraged_q[1, 0] == pytest.approx(-187.5)


def test_averages_change_neither_learning_nor_exploration(frozen_lake):
    plain, averaging = (QLearning("QTable", frozen_lake(), seed=0, averaging=share) for share in (None, 0.01))
    for model in (plain, averaging):
        model.learn(2000)
    np.testing.assert_array_equal(averaging._unaveraged_q, plain.policy.q)
    np.testing.assert_array_equal(averaging.policy.visits, plain.policy.visits)
    assert not np.array_equal(averaging.policy.q, plain.policy.q)
