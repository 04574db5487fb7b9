"""A resumed training equals the uninterrupted one, to the bit; what does not fit is refused."""

import shutil

import numpy as np
import pytest
from filelock import FileLock

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.simulation.simulator import default_physics
from tb2rl.training.training import resume, train_config

SB3, CONTRIB = "stable_baselines3", "sb3_contrib"
ON_POLICY = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 2}
OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 200, "agent.batch_size": 16}  # full when it is saved
NOISY = {"agent.use_sde": True}  # exploration matrices, drawn once a rollout
LSTM = {"agent.policy_kwargs.lstm_hidden_size": 8, "agent.policy_kwargs.n_lstm_layers": 2}
NORMALISED = {"train.norm_obs": True, "train.norm_reward": True}
FRAMES = {"task.frame_stack": 4}
VARIED = {"task.variation": "strong", "task.dynamic_obstacles": [{"people": 2}, {"boxes": 1}]}
CAMERA = {"camera": {"width": 36, "height": 36}}
SMALL = {"agent.policy_kwargs.net_arch": [16], "task.observation": "raw", "task.laser_noise": 0.01}
MAZE, DRIVE, PICTURED = "maze", "drive", "my_tasks:Pictured"
FAST = [  # each kind of state at least once: buffers, noise, recurrent states, statistics, frames, images, variation
    (f"{SB3}:A2C", DRIVE, {"agent.n_steps": 8, **NOISY}),
    (f"{SB3}:PPO", MAZE, {**ON_POLICY, **FRAMES, **VARIED}),
    (f"{SB3}:PPO", DRIVE, {**ON_POLICY, **NOISY, "agent.sde_sample_freq": 4, "train.norm_reward": True}),
    (f"{SB3}:DQN", PICTURED, {**OFF_POLICY, **NORMALISED}),
    (f"{SB3}:SAC", DRIVE, {**OFF_POLICY, **NOISY, "agent.train_freq": 8}),
    (f"{SB3}:TD3", DRIVE, {**OFF_POLICY, **NORMALISED}),
    (f"{CONTRIB}:RecurrentPPO", DRIVE, {**ON_POLICY, **LSTM, **NORMALISED, **FRAMES}),
]
SLOW = [
    (f"{SB3}:PPO", MAZE, {**ON_POLICY, "task.observe": [CAMERA]}),
    (f"{SB3}:PPO", MAZE, {**ON_POLICY, **FRAMES, "task.observation": "discrete"}),
    (f"{SB3}:DQN", MAZE, {**OFF_POLICY, "agent.n_steps": 3, "agent.buffer_size": 400}),
    (f"{SB3}:DQN", MAZE, {**OFF_POLICY, "task.observe": [CAMERA, "laser", "imu", "twist", "last_action"]}),
    (f"{SB3}:DDPG", DRIVE, OFF_POLICY),
    (f"{SB3}:SAC", DRIVE, {**OFF_POLICY, **NORMALISED, **FRAMES, "agent.ent_coef": 0.1}),
    (f"{CONTRIB}:QRDQN", MAZE, OFF_POLICY),
    (f"{CONTRIB}:TQC", DRIVE, {**OFF_POLICY, **NOISY}),
    (f"{CONTRIB}:CrossQ", DRIVE, OFF_POLICY),
    (f"{CONTRIB}:TRPO", MAZE, {"agent.n_steps": 16, "agent.batch_size": 32}),
    (f"{CONTRIB}:RecurrentPPO", PICTURED, {**ON_POLICY, **LSTM}),
]
EACH = ["kinematic", *(pytest.param(name, marks=pytest.mark.slow) for name in ("bullet", "mujoco"))]
SHORT = {"simulation": default_physics().name, "total_timesteps": 64, "n_envs": 1}


@pytest.mark.parametrize(
    ("agent", "task", "settings", "simulation"),
    [
        *((*case, "kinematic") for case in FAST),
        *(pytest.param(*case, "kinematic", marks=pytest.mark.slow) for case in SLOW),
        *(pytest.param(*case, "bullet", marks=pytest.mark.slow) for case in [*FAST[:4], SLOW[1]]),
        *(pytest.param(*case, "mujoco", marks=pytest.mark.slow) for case in FAST[:2]),
    ],
)
def test_a_resumed_training_equals_the_uninterrupted_one(
    agent, task, settings, simulation, small, killed, assert_same_runs, tmp_path
):
    train = {"n_envs": 4 if simulation == "kinematic" else 2, "total_timesteps": 512, "save_freq": 256, "keep": 9}
    config = small(agent, task, {**SMALL, **settings}, simulation=simulation, episode_steps=40, **train)
    whole = train_config(config, tmp_path / "whole").run
    assert len(whole.checkpoints) == 2
    resumed = killed(whole, tmp_path / "resumed")
    assert resume(resumed.folder).timesteps == 256
    assert_same_runs(whole, resumed)


@pytest.mark.parametrize("simulation", EACH)
@pytest.mark.parametrize(
    ("agent", "settings"), [("qlearn", {}), ("ppo", {"agent.n_steps": 16, "agent.batch_size": 64})]
)
def test_evaluations_and_curves_continue_without_a_gap(
    agent, settings, simulation, small, killed, assert_same_runs, evaluations, scalars, tmp_path
):
    train = {"simulation": simulation, "total_timesteps": 512, "save_freq": 256, "keep": 9, "stop_score": None}
    train |= {"eval_freq": 128, "eval_episodes": 2, "eval_steps": 20, "episode_steps": 60}
    whole = train_config(small(agent, "maze", {**settings, "task.laser_noise": 0.01}, **train), tmp_path / "whole").run
    resumed = killed(whole, tmp_path / "resumed")
    assert 0 < resume(resumed.folder).timesteps < 512
    assert_same_runs(whole, resumed)
    curves = [scalars(run, "eval/mean_return") for run in (whole, resumed)]
    assert curves[0] == curves[1], "no gap and no overlap"
    assert len(curves[0]) == len(evaluations(whole)) == 4


@pytest.mark.parametrize("simulation", EACH)
def test_a_training_in_many_worlds_resumes_to_the_bit(simulation, small, killed, assert_same_runs, tmp_path):
    settings = {"task.world": {"generator": "mixed", "worlds": 64}, "task.start_clearance": 0.25} | ON_POLICY
    train = {"simulation": simulation, "n_envs": 8, "total_timesteps": 256, "episode_steps": 10, "keep": 9}
    config = small("ppo", "maze", {**settings, "task.collision_range": 0.0}, **train, save_freq=128)
    whole = train_config(config, tmp_path / "whole").run
    resumed = killed(whole, tmp_path / "resumed")
    assert resume(resumed.folder).timesteps == 128
    assert_same_runs(whole, resumed)
    state = read_checkpoint(whole.checkpoints[0])["training"]["environments"]["loop"]["simulator"]
    parts = state["worlds"] if simulation == "bullet" else [state]
    worlds = np.concatenate([np.atleast_1d(part["initial_state"][:, 3]) for part in parts])
    assert len(np.unique(worlds)) > 4, "environments in worlds of their own"


def test_a_finished_run_continues_if_more_steps_are_asked(small, tmp_path):
    run = train_config(small(**SHORT), tmp_path / "run").run
    with pytest.raises(InputError, match="has all its 64 steps"):
        resume(run.folder)
    with pytest.raises(InputError, match="the total is 64 steps already"):
        resume(run.folder, 32)
    with FileLock(run.folder / ".lock"), pytest.raises(InputError, match="another process"):
        resume(run.folder, 128)

    def killed(_folder):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):  # before its first checkpoint
        resume(run.folder, 128, on_start=killed)
    assert resume(run.folder).timesteps == 64
    assert Run.open(run.folder).config.train.total_timesteps == 128
    assert load(run.folder).num_timesteps == 128


def test_the_last_checkpoint_holds_the_best_score(small, evaluations, tmp_path):
    run = train_config(small(**SHORT, eval_freq=64, eval_episodes=2, eval_steps=20), tmp_path / "run").run
    saved = read_checkpoint(run.checkpoints[0])["training"]["callbacks"]
    last = evaluations(run)[-1]
    assert [state["best"] for state in saved if "best" in state] == [[last["success_rate"], last["mean_return"]]]


def test_a_checkpoint_of_another_run_or_without_a_state_is_refused(small, tmp_path):
    runs = [train_config(small(seed=seed), tmp_path / str(seed)).run for seed in (0, 1)]
    for other in (runs[0].checkpoints[0], runs[1].folder / "final" / "policy.safetensors"):
        shutil.copy(other, runs[1].checkpoints[0])
        with pytest.raises(InputError, match="does not belong to the training of"):
            resume(runs[1].folder, 256)
    shutil.rmtree(runs[1].folder / "checkpoints")
    with pytest.raises(InputError, match="has no checkpoint to resume from"):
        resume(runs[1].folder)


def test_a_state_that_does_not_fit_is_refused_and_leaves_the_folder_as_it_was(small, tmp_path):
    run = train_config(small(n_envs=1, eval_freq=64, eval_steps=5), tmp_path / "run").run
    content = read_checkpoint(run.checkpoints[0])
    del content["training"]["environments"]
    write_checkpoint(run.checkpoints[0], content)
    before = {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()}
    with pytest.raises(InputError, match="the state of the training is damaged") as refused:
        resume(run.folder, 256)
    assert str(run.checkpoints[0]) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()} == before


def test_old_checkpoints_are_removed_but_never_the_last(small, tmp_path):
    for freq, kept in ((0, [64]), (10, [64, 60, 50])):
        run = train_config(small(n_envs=1, total_timesteps=64, save_freq=freq, keep=3), tmp_path / str(freq)).run
        assert [int(file.stem[5:]) for file in run.checkpoints] == kept
