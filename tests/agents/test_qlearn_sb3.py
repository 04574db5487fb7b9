"""Q-learning within Stable-Baselines3: callbacks, processes, logs, and saved tables."""

import numpy as np
import pytest
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback, StopTrainingOnMaxEpisodes
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import SubprocVecEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl.agents.qlearn import QLearning
from tb2rl.core.processes import process_context


def test_sb3s_callbacks_evaluate_checkpoint_and_stop(tmp_path, drive):
    model = QLearning("QTable", Monitor(drive()))
    checkpoints = CheckpointCallback(save_freq=5, save_path=str(tmp_path))
    evaluation = EvalCallback(Monitor(drive()), best_model_save_path=str(tmp_path), eval_freq=5, verbose=0)
    model.learn(1000, callback=[checkpoints, evaluation, StopTrainingOnMaxEpisodes(6)])
    assert model.num_timesteps == 12
    files = {"best_model.zip", "rl_model_10_steps.zip", "rl_model_5_steps.zip"}
    assert {file.name for file in tmp_path.iterdir()} == files
    assert evaluation.best_mean_reward == -195.0
    assert QLearning.load(tmp_path / "rl_model_5_steps.zip").num_timesteps == 5


@pytest.mark.slow
def test_it_trains_in_subprocesses_of_sb3():
    process_context()  # SB3 forks from the same server
    environments = make_vec_env("tb2rl:TurtleBot2Maze-v0", 2, vec_env_cls=SubprocVecEnv)
    try:
        model = QLearning("QTable", environments).learn(20)
    finally:
        environments.close()
    assert model.policy.visits.sum() == 20


def test_it_logs_to_tensorboard(tmp_path, drive):
    QLearning("QTable", Monitor(drive(actions=2)), tensorboard_log=str(tmp_path)).learn(40, log_interval=10)
    events = EventAccumulator(str(tmp_path / "QLearning_1")).Reload()
    logged = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    assert logged["rollout/ep_rew_mean"] == [(20, -195.0), (40, -195.0)]
    assert logged["rollout/ep_len_mean"] == [(20, 2.0), (40, 2.0)]
    assert logged["train/visited_share"][-1] == (40, pytest.approx(4 / 6)), "nothing is done where episodes end"
    assert {"rollout/exploration_rate", "train/learning_rate", "time/fps"} <= logged.keys()


def test_a_saved_model_acts_the_same_and_continues_to_learn(tmp_path, frozen_lake, epsilons):
    settings = {"exploration_decay": 0.9, "averaging": 0.1, "seed": 0}
    model = QLearning("QTable", frozen_lake(), **settings).learn(2000)
    model.save(tmp_path / "model")
    again = QLearning.load(tmp_path / "model", env=frozen_lake())
    states = np.arange(16)
    np.testing.assert_array_equal(again.predict(states)[0], model.predict(states)[0])
    np.testing.assert_array_equal(again._unaveraged_q, model._unaveraged_q)
    epsilon, visits = model.exploration_rate, model.policy.visits.sum()
    assert epsilons(again, 100, reset_num_timesteps=False)[0] == epsilon, "resuming does not explore from the start"
    assert (again.num_timesteps, again.policy.visits.sum()) == (2100, visits + 100)


def test_a_saved_table_holds_only_the_visited_pairs(frozen_lake):
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
