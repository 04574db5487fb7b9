"""A resumed training goes on as if nothing had happened, to the bit, whatever algorithm learns."""

from __future__ import annotations

import json

import pytest

from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.training.training import resume, train_config

SB3, CONTRIB = "stable_baselines3", "sb3_contrib"
ON_POLICY = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 2}
OFF_POLICY = {"agent.learning_starts": 64, "agent.buffer_size": 200, "agent.batch_size": 16}  # full when it is saved
EXPLORING = {"agent.use_sde": True}  # with matrices of noise, drawn once a rollout
MEMORY = {"agent.policy_kwargs.lstm_hidden_size": 8, "agent.policy_kwargs.n_lstm_layers": 2}
NORMALISED = {"train.norm_obs": True, "train.norm_reward": True}
FRAMES = {"task.frame_stack": 4}
VARIED, MOVING = {"task.variation": "strong"}, {"task.dynamic_obstacles": [{"people": 2}, {"boxes": 1}]}
CAMERA, TOLD = {"camera": {"width": 36, "height": 36}}, ["twist", "last_action"]
SMALL = {"agent.policy_kwargs.net_arch": [16], "task.observation": "raw", "task.laser_noise": 0.01}
ALGORITHMS = {
    "A2C": (f"{SB3}:A2C", "maze", {"agent.n_steps": 8}),
    "A2C, noisy": (f"{SB3}:A2C", "my_tasks:Glide", {"agent.n_steps": 8, **EXPLORING}),
    "PPO": (f"{SB3}:PPO", "maze", ON_POLICY),
    "PPO, continuous": (f"{SB3}:PPO", "my_tasks:Glide", ON_POLICY),
    "PPO, noisy": (f"{SB3}:PPO", "my_tasks:Glide", {**ON_POLICY, **EXPLORING}),
    "PPO, often noisy": (f"{SB3}:PPO", "my_tasks:Glide", {**ON_POLICY, **EXPLORING, "agent.sde_sample_freq": 4}),
    "DQN": (f"{SB3}:DQN", "maze", OFF_POLICY),
    "DQN, three steps": (f"{SB3}:DQN", "maze", {**OFF_POLICY, "agent.n_steps": 3, "agent.buffer_size": 400}),
    "DQN, an image": (f"{SB3}:DQN", "my_tasks:Pictured", OFF_POLICY),
    "PPO, a camera": (f"{SB3}:PPO", "maze", {**ON_POLICY, "task.observe": [CAMERA]}),
    "DQN, a camera and more": (f"{SB3}:DQN", "maze", {**OFF_POLICY, "task.observe": [CAMERA, "laser", "imu", *TOLD]}),
    "DDPG": (f"{SB3}:DDPG", "my_tasks:Glide", OFF_POLICY),
    "TD3": (f"{SB3}:TD3", "my_tasks:Glide", OFF_POLICY),
    "SAC": (f"{SB3}:SAC", "my_tasks:Glide", OFF_POLICY),
    "SAC, fixed entropy": (f"{SB3}:SAC", "my_tasks:Glide", {**OFF_POLICY, "agent.ent_coef": 0.1}),
    "SAC, noisy": (f"{SB3}:SAC", "my_tasks:Glide", {**OFF_POLICY, **EXPLORING, "agent.train_freq": 8}),
    "QRDQN": (f"{CONTRIB}:QRDQN", "maze", OFF_POLICY),
    "TQC": (f"{CONTRIB}:TQC", "my_tasks:Glide", OFF_POLICY),
    "CrossQ": (f"{CONTRIB}:CrossQ", "my_tasks:Glide", OFF_POLICY),
    "TRPO": (f"{CONTRIB}:TRPO", "maze", {"agent.n_steps": 16, "agent.batch_size": 32}),
    "RecurrentPPO": (f"{CONTRIB}:RecurrentPPO", "maze", {**ON_POLICY, **MEMORY}),
    "RecurrentPPO, an image": (f"{CONTRIB}:RecurrentPPO", "my_tasks:Pictured", {**ON_POLICY, **MEMORY}),
    "RecurrentPPO, noisy": (f"{CONTRIB}:RecurrentPPO", "my_tasks:Glide", {**ON_POLICY, **MEMORY, **EXPLORING}),
    "PPO, normalised": (f"{SB3}:PPO", "maze", {**ON_POLICY, **NORMALISED}),
    "PPO, only rewards normalised": (f"{SB3}:PPO", "maze", {**ON_POLICY, "train.norm_reward": True}),
    "PPO, frames": (f"{SB3}:PPO", "maze", {**ON_POLICY, **FRAMES}),
    "PPO, varied frames": (f"{SB3}:PPO", "maze", {**ON_POLICY, **FRAMES, **VARIED}),
    "PPO, varied, among movers": (f"{SB3}:PPO", "maze", {**ON_POLICY, **VARIED, **MOVING}),
    "PPO, frames of classes": (f"{SB3}:PPO", "maze", {**ON_POLICY, **FRAMES, "task.observation": "discrete"}),
    "DQN, an image, normalised frames": (f"{SB3}:DQN", "my_tasks:Pictured", {**OFF_POLICY, **NORMALISED, **FRAMES}),
    "TD3, normalised": (f"{SB3}:TD3", "my_tasks:Glide", {**OFF_POLICY, **NORMALISED}),
    "SAC, normalised frames": (f"{SB3}:SAC", "my_tasks:Glide", {**OFF_POLICY, **NORMALISED, **FRAMES}),
    "RecurrentPPO, normalised frames": (
        f"{CONTRIB}:RecurrentPPO",
        "my_tasks:Glide",
        {**ON_POLICY, **MEMORY, **NORMALISED, **FRAMES},
    ),
    "TQC, noisy": (f"{CONTRIB}:TQC", "my_tasks:Glide", {**OFF_POLICY, **EXPLORING}),
}
SOON = {  # for a training of 2048 steps
    "dqn": {"agent.learning_starts": 300, "agent.target_update_interval": 500, "agent.buffer_size": 1500},
    "ppo": {"agent.n_steps": 32, "agent.batch_size": 64},
    "qlearn": {},
    "sac": {"agent.learning_starts": 300, "agent.buffer_size": 1500, "agent.gradient_steps": 1},
    "td3": {"agent.learning_starts": 300, "agent.buffer_size": 1500, "agent.gradient_steps": 1},
    "recurrent_ppo": {"agent.n_steps": 32, "agent.batch_size": 64, "agent.policy_kwargs.lstm_hidden_size": 8},
}
TASKS = {"sac": "drive", "td3": "drive"}  # the others: `maze`


LONGER = {
    "SAC",
    "TD3",
    "RecurrentPPO",
    *(name for name in ALGORITHMS if any(w in name for w in ("frames", "normalised", "camera", "dynamic_obstacles"))),
}
TWIN_ONLY = {"A2C, noisy", "PPO, often noisy", "DQN, three steps", "SAC, fixed entropy", "TQC, noisy"}
TWIN_ONLY |= {"TRPO", "CrossQ", "RecurrentPPO, an image", "RecurrentPPO, noisy", "PPO, only rewards normalised"}
TWIN = [pytest.param(name, "kinematic", 4, id=f"{name} in the twin") for name in ALGORITHMS]
PYBULLET = [
    pytest.param(name, "bullet", 2, id=f"{name} in PyBullet", marks=pytest.mark.slow)
    for name in ALGORITHMS
    if name not in TWIN_ONLY
]


@pytest.mark.parametrize(("name", "simulation", "environments"), [*TWIN, *PYBULLET])
def test_a_resumed_training_is_the_uninterrupted_one(
    name, simulation, environments, small, killed, differences, tmp_path
):
    agent, task, settings = ALGORITHMS[name]
    steps = 1024 if name in LONGER else 512
    train = {
        "simulation": simulation,
        "n_envs": environments,
        "total_timesteps": steps,
        "save_freq": steps // 2,
        "keep": 9,
    }
    config = small(agent, task, {**SMALL, **settings}, episode_steps=40, **train)
    whole = train_config(config, tmp_path / "whole").run
    assert len(whole.checkpoints) == 2
    resumed = killed(whole, tmp_path / "resumed")
    assert resume(resumed.folder).timesteps == steps // 2
    assert differences(*(read_checkpoint(run.checkpoints[0]) for run in (whole, resumed))) == []
    assert differences(*(read_checkpoint(run.policy_file) for run in (whole, resumed))) == []


@pytest.mark.parametrize(
    ("agent", "simulation", "environments"),
    [
        ("qlearn", "kinematic", 4),
        ("ppo", "kinematic", 4),
        ("sac", "kinematic", 4),
        ("td3", "kinematic", 4),
        ("recurrent_ppo", "kinematic", 4),
        pytest.param("sac", "bullet", 2, marks=pytest.mark.slow),
        pytest.param("td3", "bullet", 2, marks=pytest.mark.slow),
        pytest.param("recurrent_ppo", "bullet", 2, marks=pytest.mark.slow),
        pytest.param("qlearn", "bullet", 2, marks=pytest.mark.slow),
        pytest.param("dqn", "kinematic", 4, marks=pytest.mark.slow),
        pytest.param("ppo", "bullet", 2, marks=pytest.mark.slow),
        pytest.param("dqn", "bullet", 2, marks=pytest.mark.slow),
    ],
)
def test_evaluations_and_curves_go_on_without_a_gap(
    agent, simulation, environments, small, killed, differences, scalars, tmp_path
):
    train = {"simulation": simulation, "n_envs": environments, "total_timesteps": 2048, "save_freq": 1024, "keep": 9}
    train |= {"eval_freq": 512, "eval_episodes": 2, "eval_steps": 20, "episode_steps": 60, "stop_score": None}
    config = small(agent, TASKS.get(agent, "maze"), SOON[agent] | {"task.laser_noise": 0.01}, **train)
    whole = train_config(config, tmp_path / "whole").run
    resumed = killed(whole, tmp_path / "resumed")
    assert 0 < resume(resumed.folder).timesteps < 2048
    assert differences(*(read_checkpoint(run.checkpoints[0]) for run in (whole, resumed))) == []
    assert differences(*(read_checkpoint(run.policy_file) for run in (whole, resumed))) == []
    notes = [
        [{k: v for k, v in json.loads(line).items() if k not in {"seconds", "elapsed"}} for line in lines]
        for lines in ((run.folder / "evaluations.jsonl").read_text().splitlines() for run in (whole, resumed))
    ]
    assert notes[0] == notes[1], "no evaluation twice, none missing"
    curves = [scalars(run, "eval/mean_return") for run in (whole, resumed)]
    assert curves[0] == curves[1], "no gap and no overlap"
    assert len(curves[0]) >= 4
