"""Loading of policies from a run folder, a checkpoint or the zoo, and what is refused."""

import shutil

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import config_from, resolve
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import checkpoint_config, checkpoint_file, config_of, load


def test_a_policy_comes_back_with_its_config_and_drives(checkpoint):
    policy, content = load(checkpoint), read_checkpoint(checkpoint)
    assert policy.num_timesteps == content["timesteps"] == 128
    assert config_of(policy) == checkpoint_config(content, checkpoint) == config_from(content["config"])
    for name, array in content["policy"].items():
        np.testing.assert_array_equal(policy.policy.state_dict()[name], array)
    env = make_env(policy, world="circuit", simulation="kinematic")
    assert (env.observation_space, env.action_space) == (policy.observation_space, policy.action_space)
    assert env.scene.world.name == "circuit"
    observation, _ = env.reset(seed=0)
    env.step(policy.predict(observation, deterministic=True)[0])


def test_the_policy_of_a_run_folder_is_its_best_else_its_final_else_its_latest(runs, tmp_path):
    algorithm = load(runs / "qlearn")
    run = Run.create(tmp_path / "run", algorithm.trained_with)
    for place, timesteps in (("checkpoints/step-0000000900", 900), ("checkpoints/step-0000001000", 1000)):
        algorithm.num_timesteps = timesteps
        run.save(algorithm, place)
    assert load(run.folder).num_timesteps == 1000
    for place, timesteps in (("final/policy", 2000), ("best/policy", 500)):
        algorithm.num_timesteps = timesteps
        file = run.save(algorithm, place)
        assert load(run.folder).num_timesteps == timesteps
        assert checkpoint_file(run.folder) == file
    assert load(run.folder / "final" / "policy.safetensors").num_timesteps == 2000


def test_the_zoo_is_loaded_by_name(refused):
    assert load("zoo:maze-loop-qlearn").trained_with.task.world == "loop"
    assert checkpoint_file("zoo:maze-loop-qlearn").parts[-3:] == ("maze-loop-qlearn", "best", "policy.safetensors")
    assert "did you mean 'maze-loop-qlearn'" in refused(load, "zoo:maze-lop-qlearn")


@pytest.mark.parametrize("reference", ["no/such/run", "zoo:no-such-policy", "zoo:.."])
def test_an_unknown_reference_is_refused(reference, refused):
    assert reference.removeprefix("zoo:") in refused(load, reference)


def test_an_object_that_is_no_trained_policy_has_no_config(refused):
    assert "does not come from tb2rl.load" in refused(config_of, object())


# ---- files that do not fit


@pytest.mark.parametrize("content", [b"", b"\x80\x02}q\x00.", 100, -10], ids=str)
def test_a_file_that_is_no_checkpoint_or_a_truncated_one_is_refused(content, dqn_checkpoint, refused, tmp_path):
    content = dqn_checkpoint.read_bytes()[:content] if isinstance(content, int) else content
    (tmp_path / "policy.safetensors").write_bytes(content)
    assert "policy.safetensors is not a checkpoint" in refused(load, tmp_path / "policy.safetensors")


def test_another_format_is_refused_with_the_supported_one(dqn_checkpoint, refused, monkeypatch, tmp_path):
    file = shutil.copy(dqn_checkpoint, tmp_path / "policy.safetensors")
    monkeypatch.setattr("tb2rl.runs.checkpoint.FORMAT", 3)
    assert "its format is 2, but this version of tb2rl reads 3" in refused(load, file)


@pytest.mark.parametrize("config", ["- 1", "agent: 3\ntask: {name: maze}", "agent: {name: qlearn}", "{", None])
def test_a_folder_that_is_not_a_run_is_refused(config, refused, tmp_path):
    if config is not None:
        (tmp_path / "config.yaml").write_text(config)
    assert str(tmp_path) in refused(load, tmp_path)


def test_a_run_without_a_checkpoint_says_so(refused, tmp_path):
    Run.create(tmp_path / "run", resolve())
    hint = "has no policy yet; wait for its training, or remove the folder and train again"
    assert hint in refused(load, tmp_path / "run")


@pytest.mark.parametrize(
    ("place", "value", "named"),
    [
        ("config", ..., "'config'"),
        ("config/agent", {"name": "wallfollower"}, "wallfollower"),
        ("config/agent", {"name": "sac"}, "agent sac learns continuous"),
        ("config/agent", {"name": "qlearn"}, "task.observation=discrete"),
        ("config/task/world", "no_such", "no_such"),
        ("config/train/device", "nowhere", "train.device"),
        ("timesteps", ..., "timesteps"),
        ("timesteps", -1, "timesteps: "),
    ],
)
def test_a_content_that_does_not_fit_is_refused(place, value, named, dqn_checkpoint, edited, refused, tmp_path):
    file = edited(dqn_checkpoint, tmp_path / "policy.safetensors", place, value)
    message = refused(load, file)
    assert message.startswith(str(file))
    assert named in message


def test_another_agents_checkpoint_is_refused(dqn_checkpoint, edited, refused, tmp_path):
    file = edited(dqn_checkpoint, tmp_path / "policy.safetensors", "config", resolve("ppo").to_dict())
    assert refused(load, file).startswith(f"{file} contradicts its config")
