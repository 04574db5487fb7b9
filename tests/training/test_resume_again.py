"""What can be resumed and what cannot: finished runs, folders in use, checkpoints of other runs, states that lie."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from filelock import FileLock

from tb2rl import load
from tb2rl.core.errors import InputError
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.training.training import resume, train_config

SHORT = {"simulation": "bullet", "total_timesteps": 64, "n_envs": 1}


def test_a_finished_run_goes_on_when_more_is_asked(small, tmp_path):
    train_config(small(**SHORT), tmp_path / "run")
    with pytest.raises(InputError, match="has all its 64 steps"):
        resume(tmp_path / "run")
    with pytest.raises(InputError, match="begun with 64"):
        resume(tmp_path / "run", 32)
    assert resume(tmp_path / "run", 128).timesteps == 64
    assert Run.open(tmp_path / "run").config.train.total_timesteps == 128
    assert load(tmp_path / "run").num_timesteps == 128


def test_a_resume_with_more_steps_that_ends_before_its_first_checkpoint_can_be_done_again(small, tmp_path):
    def killed(_folder):
        raise KeyboardInterrupt

    run = train_config(small(**SHORT), tmp_path / "run").run
    with pytest.raises(KeyboardInterrupt):
        resume(run.folder, 128, began=killed)
    assert resume(run.folder).timesteps == 64


def test_a_run_that_goes_on_keeps_its_best_score(small, tmp_path):
    config = small(**SHORT, eval_freq=64, eval_episodes=2, eval_steps=20)
    run = train_config(config, tmp_path / "run").run
    remembered = read_checkpoint(run.checkpoints[0])["training"]["callbacks"]
    noted = json.loads((run.folder / "evaluations.jsonl").read_text().splitlines()[-1])
    assert [state["best"] for state in remembered if "best" in state] == [[noted["success_rate"], noted["mean_return"]]]


def test_two_processes_do_not_train_in_one_folder(small, tmp_path):
    run = train_config(small(**SHORT), tmp_path / "run").run
    with FileLock(run.folder / ".lock"), pytest.raises(InputError, match="another process"):
        resume(run.folder, 128)
    assert resume(run.folder, 128).timesteps == 64


def test_another_runs_checkpoint_is_not_gone_on_with(small, tmp_path):
    runs = [train_config(small(seed=seed), tmp_path / str(seed)).run for seed in (0, 1)]
    shutil.copy(runs[0].checkpoints[0], runs[1].checkpoints[0])
    with pytest.raises(InputError, match="not a checkpoint of the training that"):
        resume(runs[1].folder, 256)


def test_a_policy_without_the_state_of_its_training_is_not_gone_on_with(small, tmp_path):
    run = train_config(small(), tmp_path / "run").run
    shutil.copy(run.folder / "final" / "policy.safetensors", run.checkpoints[0])
    with pytest.raises(InputError, match="not a checkpoint of the training that"):
        resume(run.folder, 256)


def test_a_folder_without_a_checkpoint_is_not_gone_on_with(small, tmp_path):
    run = Run.create(tmp_path / "run", small())
    with pytest.raises(InputError, match="has no checkpoint of its training"):
        resume(run.folder)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_state_that_does_not_fit_is_refused_and_the_folder_is_left_as_it_was(simulation, small, tmp_path):
    run = train_config(small(simulation=simulation, n_envs=1, eval_freq=64, eval_steps=5), tmp_path / "run").run
    content = read_checkpoint(run.checkpoints[0])
    del content["training"]["environments"]
    write_checkpoint(run.checkpoints[0], content)
    before = {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()}
    with pytest.raises(InputError, match="does not fit this training") as refused:
        resume(run.folder, 256)
    assert str(run.checkpoints[0]) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize(("simulation", "environments", "steps"), [("kinematic", 32, 1024), ("bullet", 2, 256)])
def test_a_training_in_many_worlds_resumes_to_the_bit(
    simulation, environments, steps, small, killed, differences, tmp_path
):
    world = {"task.world": {"generator": "mixed", "worlds": 512}, "task.start_clearance": 0.25}
    ppo = {"agent.n_steps": 16, "agent.batch_size": 32, "agent.n_epochs": 2, "task.collision_range": 0.0}
    train = {"simulation": simulation, "total_timesteps": steps, "n_envs": environments, "episode_steps": 10, "keep": 9}
    train |= {"save_freq": steps // 2, "eval_freq": steps // 2, "eval_episodes": 5, "eval_steps": 5}
    whole = train_config(small("ppo", "maze", {**world, **ppo}, **train), tmp_path / "whole").run
    resumed = killed(whole, tmp_path / "resumed")
    assert resume(resumed.folder).timesteps == steps // 2
    states = [read_checkpoint(run.checkpoints[0]) for run in (whole, resumed)]
    assert differences(*states) == []
    state = states[0]["training"]["environments"]["simulation"]
    places = [part["initial_state"][:, 3] for part in ([state] if simulation == "kinematic" else state["worlds"])]
    assert len(np.unique(places)) > 0.6 * environments, "robots in worlds of their own"
