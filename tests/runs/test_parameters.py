"""Learned parameters come back; arrays that do not fit are refused in one line and never written out of bounds."""

import shutil

import numpy as np
import pytest
import torch as th

from tb2rl.runs.algorithm import make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load, load_parameters, parameters_of
from tb2rl.training.training import resume

SMALL = {"agent.policy_kwargs.net_arch": [8], "agent.buffer_size": 100, "task.observation": "raw"}
OPTIMISER = "training/others/policy.optimizer"


def make(seed=0):
    """A small untrained algorithm."""
    config = resolve("stable_baselines3:SAC", "drive", settings={**SMALL, "train.seed": seed})
    return make_algorithm(config)


def as_saved(algorithm, folder, **changes) -> dict:
    """The content of a checkpoint of an algorithm."""
    training = {**parameters_of(algorithm), **changes}
    content = {"timesteps": 7, "policy": algorithm.policy.state_dict(), "training": training}
    write_checkpoint(folder / "it.safetensors", content)
    return read_checkpoint(folder / "it.safetensors")


def update(algorithm) -> None:
    """One step of every optimiser."""
    for optimiser in (algorithm.actor.optimizer, algorithm.critic.optimizer, algorithm.ent_coef_optimizer):
        for group in optimiser.param_groups:
            for parameter in group["params"]:
                parameter.grad = th.ones_like(parameter)
        optimiser.step()


def same_policy(one, other) -> bool:
    return all(th.equal(value, other.policy.state_dict()[name]) for name, value in one.policy.state_dict().items())


def test_all_learned_parameters_come_back(tmp_path):
    one, other = make(seed=0), make(seed=1)
    before = other.log_ent_coef.clone()
    update(one)
    load_parameters(other, {**as_saved(one, tmp_path), "training": None}, tmp_path)
    assert same_policy(one, other)
    assert th.equal(other.log_ent_coef, before), "the policy alone"
    load_parameters(other, as_saved(one, tmp_path), tmp_path / "it.safetensors")
    for _ in range(2):  # the optimisers are restored, too, and still refer to the parameters
        assert other.num_timesteps == 7
        assert th.equal(one.log_ent_coef, other.log_ent_coef)
        assert same_policy(one, other)
        update(one)
        update(other)


@pytest.mark.parametrize("value", [None, np.zeros(3, np.float32)], ids=str)
def test_tensors_beside_the_policy_must_fit(value, refused, tmp_path):
    algorithm = make()
    content = as_saved(algorithm, tmp_path, tensors={"log_ent_coef": value})
    message = refused(load_parameters, algorithm, content, tmp_path / "it.safetensors")
    assert message.startswith(f"{tmp_path / 'it.safetensors'} contradicts its config")


# ---- the policy's parameters


@pytest.mark.parametrize("value", [None, {"q": np.zeros((2, 3))}, ...], ids=str)
def test_a_policy_of_another_shape_is_refused(value, dqn_checkpoint, edited, refused, tmp_path):
    file = edited(dqn_checkpoint, tmp_path / "policy.safetensors", "policy", value)
    assert str(file) in refused(load, file)


@pytest.mark.parametrize(("pairs", "q", "visits"), [([10**9], [0.0], [1]), ([3, 4], [0.0], [1, 1]), ([3], [0.0], [-1])])
def test_a_table_is_never_written_out_of_bounds(pairs, q, visits, runs, edited, refused, tmp_path):
    table = {"pairs": np.array(pairs), "q": np.array(q), "visits": np.array(visits)}
    file = edited(Run.open(runs / "qlearn").checkpoints[0], tmp_path / "policy.safetensors", "policy", table)
    assert "contradicts its config" in refused(load, file)


# ---- the optimisers


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("state/0/exp_avg", lambda array: array[:1]),
        ("state", lambda state: {**state, 99: state["0"]}),
        ("param_groups", lambda groups: groups * 2),
    ],
)
def test_the_state_of_an_optimiser_must_fit_the_weights(place, value, runs, edited, refused, tmp_path):
    run = Run.open(shutil.copytree(runs / "dqn", tmp_path / "run"))
    file = edited(run.checkpoints[0], run.checkpoints[0], f"{OPTIMISER}/{place}", value)
    assert refused(resume, run.folder).startswith(f"{file} contradicts its config")


def test_options_of_an_optimiser_are_not_loaded(tmp_path):
    one, other = make(), make()
    content = as_saved(one, tmp_path)
    (group,) = content["training"]["others"]["actor.optimizer"]["param_groups"]
    group |= {"fused": True, "betas": [2.0, 2.0], "params": [0, 0], "no_such": object, "lr": 0.125}
    load_parameters(other, content, tmp_path)
    (theirs,), (ours,) = one.actor.optimizer.param_groups, other.actor.optimizer.param_groups
    assert ours["lr"] == 0.125
    assert [ours[key] for key in ("fused", "betas")] == [theirs[key] for key in ("fused", "betas")]
    assert "no_such" not in ours
    assert len(ours["params"]) == len(theirs["params"])
