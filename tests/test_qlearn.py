"""The tabular learner: the tutorial's algorithm by hand-computed numbers, the textbook's, and all of SB3 around it."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3.common.callbacks import (
    CheckpointCallback,
    EvalCallback,
    StopTrainingOnMaxEpisodes,
)
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl.agents.qlearn import QLearning, QTable, update_table
from tb2rl.config import resolve
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError
from tb2rl.observations import observe_as
from tb2rl.processes import process_context
from tb2rl.simulation import Reading


class Drive(gym.Env):
    """Two steps, whatever the action: state 0 to 1 for +5, 1 to 2 for -200, and there the episode ends."""

    def __init__(self, ends: str = "terminated", actions: int = 1) -> None:
        self.observation_space, self.action_space = gym.spaces.Discrete(3), gym.spaces.Discrete(actions)
        self.ends = ends

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = 0
        return self.state, {}

    def step(self, action):
        self.state += 1
        over = self.state == 2
        reward = -200.0 if over else 5.0
        return self.state, reward, over and self.ends == "terminated", over and self.ends == "truncated", {}


class Bandit(gym.Env):
    """Episodes of one step from the only state; action 0 pays 1, action 1 pays 2, and so on."""

    def __init__(self, actions: int = 1) -> None:
        self.observation_space, self.action_space = gym.spaces.Discrete(1), gym.spaces.Discrete(actions)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        return 0, 1.0 + action, True, False, {}


def frozen_lake(slippery: bool = False) -> gym.Env:
    return Monitor(gym.make("FrozenLake-v1", is_slippery=slippery))


def values_after(episodes: int, **arguments) -> list[float]:
    """Q of states 0 and 1 after driving; the state that the episode ends in is worth 10."""
    ends = arguments.pop("ends", "terminated")
    model = QLearning("QTable", Drive(ends), learning_rate=0.1, gamma=0.7, **arguments)
    model.policy.q[2] = 10.0
    model.learn(2 * episodes)
    return model.policy.q[:2, 0].tolist()


def shares_of_choices(values: list[float], steps: int = 20_000, **arguments) -> np.ndarray:
    """How often each action of a state with these values is taken, while they stay as they are."""
    model = QLearning("QTable", make_vec_env(lambda: Bandit(len(values)), 50), learning_rate=0.0, seed=0, **arguments)
    model.policy.q[0] = model.policy.q.new_tensor(values)
    model.learn(steps)
    assert model.policy.q[0].tolist() == values
    return model.policy.visits[0].numpy() / steps


def epsilons(model: QLearning, steps: int, **arguments) -> list[float]:
    """Epsilon at the choice of each action."""
    seen = []
    model.learn(steps, callback=lambda local, _: seen.append(local["self"].exploration_rate) or True, **arguments)
    return seen


# ---- the tutorial


def test_the_tutorial_preset_carries_the_tutorials_numbers():
    config = resolve(preset="tutorial")
    assert (config.agent, config.task, config.observation) == ("qlearn", "maze", "discrete")
    assert config.agent_settings == {
        "learning_rate": 0.1,
        "gamma": 0.7,
        "exploration": "noisy_values",
        "exploration_initial_eps": 0.9,
        "exploration_final_eps": 0.05,
        "exploration_decay": 0.999,
        "update": "tutorial",
    }
    task, train = config.task_settings, config.train
    assert task.commands.tolist() == [[0.5, 0.0], [0.05, 0.3], [0.05, -0.3]]
    assert (task.forward_reward, task.turn_reward, task.crash_reward, task.crash_range) == (5.0, 1.0, -200.0, 0.5)
    assert (task.beams, task.kept, task.noise, task.start) == (720, (0, 144, 288, 432, 576), 0.0, "fixed")
    assert (train.episodes, task.episode_steps, train.n_envs, train.reward_scale) == (500, 10_000, 1, 1.0)
    assert train.total_timesteps >= 500 * 10_000, "the episodes end the training, not the steps"


def test_the_tutorial_preset_observes_the_integer_part_of_the_reading():
    observe, laser = observe_as("discrete", resolve(preset="tutorial").task_settings)
    assert np.degrees(laser.angles) == pytest.approx([-90 + i * 180 / 719 for i in (0, 144, 288, 432, 576)])
    assert observe.space.nvec.tolist() == [7] * 5

    def classes(*ranges: float) -> list[int]:
        still = np.zeros((1, 3))
        return observe(Reading(still, still[:, :2], still, np.array([ranges]), np.array([False])))[0].tolist()

    assert classes(0.3, 0.99, 1.0, 1.99, 2.0) == [0, 0, 1, 1, 2]
    assert classes(5.99, 6.0, 29.0, np.inf, np.nan) == [5, 6, 6, 6, 0]


def test_the_tutorials_first_visit_stores_the_plain_reward():
    assert values_after(1, update="tutorial") == [5.0, -200.0]


def test_the_tutorials_later_visits_bootstrap_also_through_a_crash():
    # 5 + 0.1 (5 + 0.7 * -200 - 5), and -200 + 0.1 (-200 + 0.7 * 10 + 200)
    assert values_after(2, update="tutorial") == pytest.approx([-9.0, -199.3])


def test_the_tutorials_epsilon_falls_at_the_start_of_each_episode_until_it_is_small():
    tutorial = resolve(preset="tutorial").agent_settings
    seen = epsilons(QLearning("QTable", Bandit(), **tutorial), 3000)
    assert seen[:2] == pytest.approx([0.9 * 0.999, 0.9 * 0.999**2])
    assert seen[499] == pytest.approx(0.9 * 0.999**500)
    assert seen[499] == pytest.approx(0.546, abs=5e-4)
    falls = math.ceil(math.log(0.05 / 0.9) / math.log(0.999))  # 2889: the first epsilon that is not above 0.05
    assert seen[falls - 2] > 0.05 >= seen[falls - 1]
    assert seen[-1] == seen[falls - 1] == pytest.approx(0.9 * 0.999**falls)


def test_an_episode_counts_for_the_decay_and_its_steps_do_not():
    model = QLearning("QTable", Drive(), exploration_initial_eps=0.9, exploration_decay=0.5)
    assert epsilons(model, 5) == [0.45, 0.45, 0.225, 0.225, 0.1125]


# The noise of two actions differs by less than the width w = max |q|, with a triangular density: the second best action
# wins with probability (1 - gap / w)^2 / 2.
@pytest.mark.parametrize(
    ("values", "share"),
    [([10.0, 4.0], 0.4**2 / 2), ([-10.0, -4.0], 1 - 0.4**2 / 2), ([10.0, -0.1], 0.0), ([-8.0, 2.5], 1.0)],
)
def test_noisy_values_choose_by_the_gap_relative_to_the_largest_value(values, share):
    always = {"exploration": "noisy_values", "exploration_initial_eps": 1.0, "exploration_final_eps": 1.0}
    tolerance = 0.01 if 0 < share < 1 else 0.0
    assert shares_of_choices(values, **always)[1] == pytest.approx(share, abs=tolerance)


def test_noisy_values_add_noise_only_with_probability_epsilon():
    sometimes = {"exploration": "noisy_values", "exploration_initial_eps": 0.5, "exploration_final_eps": 0.5}
    assert shares_of_choices([10.0, 4.0], **sometimes)[1] == pytest.approx(0.5 * 0.4**2 / 2, abs=0.01)


@pytest.mark.parametrize("exploration", ["noisy_values", "epsilon_greedy"])
@pytest.mark.parametrize(("values", "shares"), [([0.0, 0.0, 0.0], [1 / 3] * 3), ([2.0, 1.0, 2.0], [0.5, 0.0, 0.5])])
def test_ties_are_broken_at_random(exploration, values, shares):
    greedy = {"exploration": exploration, "exploration_initial_eps": 0.0, "exploration_final_eps": 0.0}
    assert shares_of_choices(values, **greedy) == pytest.approx(shares, abs=0.015)


# ---- the textbook


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ("terminated", [0.5 + 0.1 * (5 + 0.7 * -20 - 0.5), -20 + 0.1 * (-200 + 20)]),  # nothing follows a crash
        ("truncated", [0.5 + 0.1 * (5 + 0.7 * -19.3 - 0.5), -19.3 + 0.1 * (-200 + 0.7 * 10 + 19.3)]),
    ],
)
def test_textbook_updates_bootstrap_at_a_time_limit_and_not_at_a_crash(ends, expected):
    assert values_after(2, ends=ends) == pytest.approx(expected)


@pytest.mark.parametrize("plain_first", [False, True])
def test_updates_of_one_pair_by_several_robots_happen_one_after_the_other(plain_first):
    rng = np.random.default_rng(0)
    states, reached = rng.integers(3, size=(2, 200))
    actions, ended, rewards = rng.integers(2, size=200), rng.random(200) < 0.2, rng.normal(size=200)
    q, visits = np.zeros((3, 2)), np.zeros((3, 2), dtype=np.int64)
    update_table(q, visits, states, actions, reached, ended, rewards, 0.3, 0.9, plain_first)

    expected, seen = np.zeros((3, 2)), np.zeros((3, 2), dtype=np.int64)
    for s, a, n, over, r in zip(states, actions, reached, ended, rewards, strict=True):
        target = r if over else r + 0.9 * max(expected[n])
        expected[s, a] = r if plain_first and seen[s, a] == 0 else expected[s, a] + 0.3 * (target - expected[s, a])
        seen[s, a] += 1
    np.testing.assert_allclose(q, expected, rtol=1e-12)
    np.testing.assert_array_equal(visits, seen)


def test_epsilon_greedy_takes_a_random_action_at_the_rate_of_epsilon():
    rate = {"exploration_initial_eps": 0.3, "exploration_final_eps": 0.3}
    assert shares_of_choices([1.0, 0.0, 0.5], **rate) == pytest.approx([0.8, 0.1, 0.1], abs=0.01)


def test_epsilon_falls_linearly_over_its_share_of_the_training():
    model = QLearning("QTable", Bandit(), exploration_final_eps=0.2, exploration_fraction=0.5)
    seen = epsilons(model, 100)
    assert (seen[0], seen[25], seen[50], seen[99]) == pytest.approx((1.0, 0.6, 0.2, 0.2))


def test_the_learning_rate_follows_its_schedule():
    model = QLearning("QTable", Bandit(), learning_rate=lambda remaining: remaining, gamma=0.0)
    model.learn(4)  # alpha 0.75, 0.5, 0.25, 0 towards a reward of 1
    assert model.policy.q.item() == pytest.approx(1 - 0.25 * 0.5 * 0.75)


def test_it_learns_the_shortest_way_over_the_frozen_lake():
    model = QLearning("QTable", frozen_lake(), learning_rate=0.5, gamma=0.9, seed=0).learn(10_000)
    returns, lengths = evaluate_policy(model, model.get_env(), n_eval_episodes=3, return_episode_rewards=True)
    assert (returns, lengths) == ([1.0] * 3, [6] * 3)
    assert model.policy.q[0].max().item() == pytest.approx(0.9**5), "the goal is six steps away"


@pytest.mark.parametrize(("initial_value", "tried"), [(10.0, 3), (0.0, 1)])
def test_a_greedy_learner_tries_everything_only_if_its_table_is_optimistic(initial_value, tried):
    greedy = {"exploration_initial_eps": 0.0, "exploration_final_eps": 0.0, "learning_rate": 0.5}
    model = QLearning("QTable", Bandit(3), policy_kwargs={"initial_value": initial_value}, **greedy).learn(50)
    assert (model.policy.visits > 0).sum() == tried
    assert tried == 1 or model.predict(np.int64(0))[0] == 2


def test_raw_observations_are_refused():
    with pytest.raises(InputError, match="observation=discrete"):
        QLearning("QTable", TurtleBot2Env(observation="raw"))


def test_equal_seeds_give_equal_tables_and_others_do_not():
    def table(seed: int) -> np.ndarray:
        return QLearning("QTable", frozen_lake(slippery=True), seed=seed).learn(500).policy.q.numpy()

    np.testing.assert_array_equal(table(3), table(3))
    assert not np.array_equal(table(3), table(4))


# ---- Stable-Baselines3 around it


def test_sb3s_callbacks_evaluate_checkpoint_and_stop(tmp_path):
    model = QLearning("QTable", Monitor(Drive()))
    checkpoints = CheckpointCallback(save_freq=5, save_path=str(tmp_path))
    evaluation = EvalCallback(Monitor(Drive()), best_model_save_path=str(tmp_path), eval_freq=5, verbose=0)
    model.learn(1000, callback=[checkpoints, evaluation, StopTrainingOnMaxEpisodes(6)])
    assert model.num_timesteps == 12
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "best_model.zip",
        "rl_model_10_steps.zip",
        "rl_model_5_steps.zip",
    ]
    assert evaluation.best_mean_reward == -195.0
    assert QLearning.load(tmp_path / "rl_model_5_steps.zip").num_timesteps == 5


def test_it_trains_on_worlds_in_processes_of_sb3():
    process_context()  # SB3 forks from the same server, which imports once what all worlds need
    worlds = make_vec_env("tb2rl:TurtleBot2Maze-v0", 2, vec_env_cls=SubprocVecEnv)
    try:
        model = QLearning("QTable", worlds).learn(20)
    finally:
        worlds.close()
    assert model.policy.visits.sum() == 20


@pytest.mark.filterwarnings("ignore::tqdm.TqdmExperimentalWarning")
def test_it_shows_a_progress_bar(capfd):
    QLearning("QTable", Bandit()).learn(10, progress_bar=True)
    assert "10/10" in "".join(capfd.readouterr())


def test_it_logs_to_tensorboard(tmp_path):
    QLearning("QTable", Monitor(Drive(actions=2)), tensorboard_log=str(tmp_path)).learn(40, log_interval=10)
    events = EventAccumulator(str(tmp_path / "QLearning_1")).Reload()
    logged = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    assert logged["rollout/ep_rew_mean"] == [(20, -195.0), (40, -195.0)]
    assert logged["rollout/ep_len_mean"] == [(20, 2.0), (40, 2.0)]
    assert logged["train/visited_share"][-1] == (40, pytest.approx(4 / 6)), "nothing is done where episodes end"
    assert {"rollout/exploration_rate", "train/learning_rate", "time/fps"} <= logged.keys()


def test_a_saved_model_acts_the_same_and_goes_on_learning(tmp_path):
    model = QLearning("QTable", frozen_lake(), exploration_decay=0.9, seed=0).learn(2000)
    model.save(tmp_path / "model")
    again = QLearning.load(tmp_path / "model", env=frozen_lake())
    states = np.arange(16)
    np.testing.assert_array_equal(again.predict(states)[0], model.predict(states)[0])
    epsilon, visits = model.exploration_rate, model.policy.visits.sum()
    assert epsilons(again, 100, reset_num_timesteps=False)[0] == epsilon, "resuming does not explore from the start"
    assert (again.num_timesteps, again.policy.visits.sum()) == (2100, visits + 100)


def test_a_saved_table_acts_the_same(tmp_path):
    policy = QLearning("QTable", frozen_lake(), seed=0).learn(2000).policy
    policy.save(tmp_path / "table")
    again = QTable.load(tmp_path / "table")
    assert [again.predict(state)[0] for state in range(16)] == [policy.predict(state)[0] for state in range(16)]


def test_a_saved_table_holds_the_tried_pairs_only_and_the_others_come_back_as_they_were():
    settings = {"policy_kwargs": {"initial_value": 2.5}, "seed": 0}
    model = QLearning("QTable", frozen_lake(), **settings).learn(100)
    state = model.policy.state_dict()
    tried = int((model.policy.visits > 0).sum())
    assert {name: len(values) for name, values in state.items()} == {"pairs": tried, "q": tried, "visits": tried}
    assert tried < model.policy.q.numel()
    other = QLearning("QTable", frozen_lake(), **{**settings, "seed": 1}).learn(300).policy
    other.load_state_dict(state)
    np.testing.assert_array_equal(other.q, model.policy.q)
    np.testing.assert_array_equal(other.visits, model.policy.visits)


@pytest.mark.parametrize(
    "lie",
    [
        {"pairs": [1, 1]},
        {"pairs": [2, 1]},
        {"pairs": [-1, 1]},
        {"pairs": [1, 64]},
        {"pairs": [2**63 - 2, -(2**63)]},
        {"pairs": [1]},
        {"pairs": [[1, 2]]},
        {"pairs": [1.0, 2.0]},
        {"q": [1.0]},
        {"q": [1, 2]},
        {"visits": [1, 0]},
        {"visits": [1, -1]},
        {"visits": [1, 2, 3]},
        {"visits": None},
        {"more": [1]},
    ],
    ids=str,
)
def test_a_table_that_cannot_have_been_saved_is_refused(lie):
    policy = QLearning("QTable", frozen_lake()).policy
    saved = {"pairs": [1, 63], "q": [0.5, 1.5], "visits": [1, 2]}
    policy.load_state_dict(tensors(saved))
    assert policy.q[15, 3] == 1.5
    with pytest.raises(RuntimeError, match=r"table's pairs|in state_dict"):
        policy.load_state_dict(tensors({**saved, **lie}))
    assert policy.q[15, 3] == 1.5, "nothing changed"


def tensors(state: dict[str, list | None]) -> dict[str, th.Tensor]:
    return {
        name: th.tensor(values, dtype=th.float64 if isinstance(values[0], float) else th.int64)
        for name, values in state.items()
        if values is not None
    }
