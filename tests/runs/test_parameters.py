"""Learned parameters come back; arrays that do not fit are refused in one line and never written out of bounds."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import torch as th

from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.runs.parameters import load_parameters, parameters_of
from tb2rl.training.training import resume

GLIDE = """
from tb2rl.tasks import Outcome, Task, Velocities

class Glide(Task):
    actions = Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0))

    def outcome(self, before, action, after):
        return Outcome(after.twist[:, 0], failed={"bump": after.bumped})
"""
SMALL = {"agent.policy_kwargs.net_arch": [8], "agent.buffer_size": 100, "task.observation": "raw"}
OPTIMISER = "training/others/policy.optimizer"
NAN, INF = float("nan"), float("inf")


@pytest.fixture
def make(tmp_path, monkeypatch):
    """A function that makes a small untrained algorithm."""
    (tmp_path / "glide.py").write_text(GLIDE)
    monkeypatch.syspath_prepend(tmp_path)

    def made(agent="stable_baselines3:SAC", seed=0):
        config = resolve(agent, "glide:Glide", settings={**SMALL, "train.seed": seed})
        return make_algorithm(config, Spaces.vectorised(config))

    return made


def as_saved(algorithm, folder, **changes) -> dict:
    """The content of a checkpoint of an algorithm."""
    parameters = parameters_of(algorithm)
    content = {"timesteps": 7, "policy": parameters.pop("policy"), "training": {**parameters, **changes}}
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


def test_all_learned_parameters_come_back(make, tmp_path):
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


TENSORS = [None, {"log_ent_coef": np.zeros(3, np.float32)}]
TENSORS += [{"log_ent_coef": np.array([value])} for value in (np.complex64(NAN), np.int64(2**62), np.float32(NAN))]


@pytest.mark.parametrize("tensors", TENSORS, ids=str)
def test_tensors_beside_the_policy_must_fit(tensors, make, refused, tmp_path):
    algorithm = make()
    content = as_saved(algorithm, tmp_path, tensors=tensors)
    message = refused(load_parameters, algorithm, content, tmp_path / "it.safetensors")
    assert message.startswith(f"{tmp_path / 'it.safetensors'} does not fit its config")


# ---- the policy's parameters


@pytest.mark.parametrize("value", [None, {"q": "q"}, {"q": np.zeros((2, 3))}, ...], ids=str)
def test_a_policy_of_another_shape_is_refused(value, dqn_checkpoint, edited, refused, tmp_path):
    file = edited(dqn_checkpoint, tmp_path / "policy.safetensors", "policy", value)
    assert str(file) in refused(load, file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *((lambda array, x=x: np.full_like(array, x), "weights that learning does not lead to") for x in (NAN, 1e30)),
        *((lambda array, t=t: array.astype(t), "another kind of numbers than the policy") for t in ("c8", "i8", "?")),
    ],
)
def test_implausible_weights_are_refused(change, message, checkpoint, edited, refused, tmp_path):
    def spoiled(policy):
        name = next(name for name, array in policy.items() if array.dtype.kind == "f" and array.size)
        return {**policy, name: change(policy[name])}

    file = edited(checkpoint, tmp_path / "policy.safetensors", "policy", spoiled)
    assert message in refused(load, file)


def test_implausible_counters_are_refused(make, refused, tmp_path):
    algorithm = make("sb3_contrib:CrossQ")  # which counts its steps
    content = as_saved(algorithm, tmp_path)
    steps = next(array for array in content["policy"].values() if array.dtype.kind == "i")
    steps[...] = 2**62
    assert "weights that learning does not lead to" in refused(load_parameters, algorithm, content, tmp_path)


@pytest.mark.parametrize(
    ("pairs", "q", "visits"),
    [
        ([10**9], [0.0], [1]),
        ([3, 3], [0.0, 0.0], [1, 1]),
        ([3, 4], [0.0], [1, 1]),
        ([3], [0.0], [-1]),
    ],
)
def test_a_table_is_never_written_out_of_bounds(pairs, q, visits, runs, edited, refused, tmp_path):
    table = {"pairs": np.array(pairs), "q": np.array(q), "visits": np.array(visits)}
    file = edited(Run.open(runs / "qlearn").checkpoints[0], tmp_path / "policy.safetensors", "policy", table)
    assert "does not fit its config" in refused(load, file)


# ---- the optimisers


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("state/0/exp_avg", lambda array: array[:1]),
        ("state/0/exp_avg_sq", lambda array: array[..., None]),
        ("state/0/step", lambda _: np.zeros(5, np.float32)),
        ("state/0/step", lambda _: np.array(NAN, np.float32)),
        ("state/0/exp_avg", lambda array: array.astype(np.complex64)),
        ("state/0/exp_avg", lambda array: np.full_like(array, INF)),
        ("param_groups/0/lr", NAN),
        ("state", lambda state: {**state, 99: state[0]}),
        ("param_groups", lambda groups: groups * 2),
    ],
)
def test_the_state_of_an_optimiser_must_fit_the_weights(place, value, runs, edited, refused, tmp_path):
    """Compiled optimisers take the shapes for granted, and would write past the end of an array."""
    run = Run.open(shutil.copytree(runs / "dqn", tmp_path / "run"))
    file = edited(run.checkpoints[0], run.checkpoints[0], f"{OPTIMISER}/{place}", value)
    assert refused(resume, run.folder).startswith(f"{file} does not fit its config")


def test_options_of_an_optimiser_are_not_loaded(make, tmp_path):
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
