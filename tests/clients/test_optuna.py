"""Optuna's trials in threads: environments and trainings in one process beside each other."""

import gymnasium as gym
import numpy as np
import pytest

import tb2rl

optuna = pytest.importorskip("optuna", reason="optuna is not installed")


@pytest.fixture
def study():
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.RandomSampler(seed=0)
    return optuna.create_study(direction="maximize", sampler=sampler)


def drive(forward, seed, simulation):
    """Return and last pose of an episode that drives forward at every `forward`-th step, and turns else."""
    env = gym.make("tb2rl:TurtleBot2Maze-v0", simulation=simulation, max_episode_steps=30)
    env.reset(seed=seed)
    total, info, step = 0.0, {"ended": ""}, 0
    while not info["ended"]:
        _, reward, _, _, info = env.step(1 if step % forward == 0 else 0)
        total, step = total + reward, step + 1
    env.close()
    return total, info["pose"]


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_episodes_in_threads_are_those_of_one_thread(study, simulation, capfd):
    def objective(trial):
        total, pose = drive(trial.suggest_int("forward", 1, 9), trial.number, simulation)
        trial.set_user_attr("pose", pose.tolist())
        return total

    study.optimize(objective, n_trials=4, n_jobs=2)
    assert capfd.readouterr().out == "", "PyBullet's messages would be in the output of the user"
    for trial in study.trials:
        total, pose = drive(trial.params["forward"], trial.number, simulation)
        assert trial.value == total
        np.testing.assert_array_equal(trial.user_attrs["pose"], pose)


@pytest.mark.slow
def test_trainings_in_threads_end_with_a_policy_each(study, tmp_path, capfd):
    def objective(trial):
        rate = trial.suggest_float("learning_rate", 1.0e-4, 1.0e-2, log=True)
        small = {"agent.n_steps": 64, "agent.batch_size": 32, "task.episode_steps": 40}
        train = {"total_timesteps": 128, "eval_freq": 0, "seed": trial.number, "folder": tmp_path / str(trial.number)}
        policy = tb2rl.train("stable_baselines3:PPO", "maze", settings={"agent.learning_rate": rate, **small}, **train)
        print(f"trial {trial.number} trained\n", end="")
        return tb2rl.evaluate(policy, episodes=1, steps=40, workers=1).episodes[0].episode_return

    study.optimize(objective, n_trials=4, n_jobs=2)
    assert sorted(capfd.readouterr().out.splitlines()) == [f"trial {n} trained" for n in range(4)]
    assert all(np.isfinite(trial.value) for trial in study.trials)
    for number in range(4):
        policy = tb2rl.load(tmp_path / str(number))
        assert policy.num_timesteps >= 128
        assert policy.predict(policy.observation_space.sample())[0] in range(3)
